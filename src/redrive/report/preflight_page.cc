// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/preflight_page.h"

#include <cstdio>

#include <opencv2/imgproc.hpp>

#include "redrive/base/files.h"
#include "redrive/report/html.h"
#include "redrive/report/svg.h"
#include "redrive/scene/lidar_returns.h"
#include "redrive/scene/masks.h"

namespace redrive {
namespace {

constexpr double kNearest_m = 2, kFarthest_m = 80;  // of LiDAR's colours
constexpr double kLidarAround_s = 0.06;             // a revolution around an image
constexpr std::size_t kLidarShown = 6000;           // points: more would hide the image
constexpr std::size_t kTriedShown = 6;

std::string row_of(const std::vector<std::string>& figures) {
  std::string out = "<div class=\"row\">\n";
  for (const std::string& figure : figures) out += figure;
  return out + "</div>\n";
}

std::string verdicts(const Recording& recording, const Preflight& preflight) {
  std::vector<std::vector<std::string>> rows = {
      {"", "verdict", "why", "offset (ms)", "error (px)", "points", "points move (px)"}};
  for (const CameraCheck& camera : preflight.cameras) {
    const bool any = !camera.tried.empty();
    rows.push_back({camera.name, verdict_name(camera.verdict), camera.why,
                    camera.offset_told ? fixed(camera.offset_ms, 1) : "-",
                    any ? fixed(camera.tried[0].error_px, 2) : "-", std::to_string(camera.points),
                    any ? fixed(camera.flow_px, 1) : "-"});
  }
  rows.push_back({"clock", verdict_name(preflight.clock.verdict), preflight.clock.why, "-", "-", "-", "-"});
  std::string out =
      "<h1>" + html_escape(recording.root.lexically_normal().filename().string()) + "</h1>\n<h2>" +
      (preflight.sensible() ? "Nothing speaks against training" : "Training makes no sense before this is put right") +
      "</h2>\n";
  return out + html_table(rows, false) +
         "<p>Error: how far, in the median, points lie from where a static point can be seen, when the calibration and "
         "the poses say how the "
         "camera moved between two images a few frames apart. Points are followed without asking the calibration, "
         "those kept that most "
         "of their image agree with. It sees directions and turns, not lengths: where the camera is to some decimetres "
         "it does not see.</p>\n";
}

/// The frame in the middle of the camera's images.
int middle_frame(const RigImages& images, int camera) {
  std::vector<int> with_image;
  for (int f = 0; f < images.frames(); ++f)
    if (!images.grey[camera][f].empty()) with_image.push_back(f);
  return with_image.empty() ? -1 : with_image[with_image.size() / 2];
}

Mask mask_of(const RigImages& images, int camera, int frame) {
  const cv::Mat& usable = images.usable[camera][frame];
  const auto moving = images.moving_at(camera, frame);
  Mask mask = full_mask(usable.cols, usable.rows);
  for (int y = 0; y < mask.height; ++y)
    for (int x = 0; x < mask.width; ++x)
      mask.used[std::size_t(y) * mask.width + x] = images.may_be_static(camera, frame, Eigen::Vector2d(x, y), moving);
  return mask;
}

cv::Scalar distance_colour(double distance_m) {
  const double unit = std::log(distance_m / kNearest_m) / std::log(kFarthest_m / kNearest_m);
  const cv::Mat level(1, 1, CV_8U, cv::Scalar(255 * std::clamp(unit, 0.0, 1.0)));
  cv::Mat colour;
  cv::applyColorMap(level, colour, cv::COLORMAP_TURBO);  // BGR
  const auto bgr = colour.at<cv::Vec3b>(0, 0);
  return cv::Scalar(bgr[2], bgr[1], bgr[0]);
}

/// Each return where it lay at its own time, in the camera as it was at the image's; near ones over far ones.
int draw_lidar(const RigImages& images, int camera, int frame, const LidarReturns& lidar, Image8* picture) {
  const std::int64_t t_ns = images.scene.frames[frame].t_ns + images.scene.rig[camera].time_offset_ns;
  const Rigid3d camera_from_world = images.world_from_camera[camera][frame].inverse();
  std::vector<std::pair<double, Eigen::Vector2d>> seen;
  const std::size_t n = lidar.n;
  for (std::size_t i = 0; i < n; ++i) {
    if (std::abs(lidar.t_ns[i] - t_ns) > static_cast<std::int64_t>(1e9 * kLidarAround_s)) continue;
    const auto at = [&](const std::vector<float>& v) { return Eigen::Vector3f(v[i], v[n + i], v[2 * n + i]); };
    const Eigen::Vector3d in_world = (at(lidar.origin) + lidar.range_m[i] * at(lidar.direction)).cast<double>();
    const Eigen::Vector3d in_camera = camera_from_world * in_world;
    if (const auto pixel = images.camera(camera).project(in_camera)) seen.emplace_back(in_camera.norm(), *pixel);
  }
  std::ranges::sort(seen, std::greater{}, [](const auto& s) { return s.first; });
  cv::Mat canvas(picture->height, picture->width, CV_8UC3, picture->rgb.data());
  const std::size_t step = 1 + seen.size() / kLidarShown;
  for (std::size_t i = 0; i < seen.size(); i += step) {
    const auto& [distance_m, pixel] = seen[i];
    cv::circle(canvas, {cvRound(4 * pixel.x()), cvRound(4 * pixel.y())}, 6, distance_colour(distance_m), cv::FILLED,
               cv::LINE_AA, 2);
  }
  return static_cast<int>((seen.size() + step - 1) / step);
}

std::string picture(const std::filesystem::path& folder, const Recording& recording, const RigImages& images,
                    int camera, const LidarReturns& lidar) {
  const int frame = middle_frame(images, camera);
  if (frame < 0) return "";
  SceneOptions options;
  options.cameras = {images.scene.rig[camera].name};
  options.downscale = images.factor[camera];
  const Scene scene = make_scene(recording, options);
  const auto view = std::ranges::find(scene.views, images.scene.frames[frame].id,
                                      [&](const View& v) { return scene.frames[v.frame].id; });
  Image8 image = load_view(scene, *view);
  image.alpha.clear();
  image.used.clear();
  Image8 tinted = overlay(image, mask_of(images, camera, frame));
  const int points = draw_lidar(images, camera, frame, lidar, &tinted);
  const std::string name = scene.rig[0].name + ".jpg";
  write_image(folder / name, tinted);
  return html_figure(
      name, "frame " + std::to_string(images.scene.frames[frame].id) +
                "; red: not looked at (a margin around masks, too); " +
                (points > 0 ? std::to_string(points) + " LiDAR points, 2 m (blue) to 80 m (red)" : "no LiDAR"));
}

std::string scan(const CameraCheck& check) {
  SvgPlot plot{"time offset (ms), added to the recorded one", "error (px)", {}, {}};
  SvgCurve curve{{}, svg_colour(0), ""};
  for (const ScanPoint& p : check.scan) curve.points.emplace_back(p.offset_ms, p.error_px);
  plot.curves.push_back(curve);
  plot.from_zero = true;
  double highest = 0;
  for (const ScanPoint& p : check.scan) highest = std::max(highest, p.error_px);
  plot.curves.push_back(
      {{{check.offset_ms, 0}, {check.offset_ms, highest}},
       "#d1495b",
       check.offset_told ? "minimum at " + fixed(check.offset_ms, 1) + " ms" : "too flat: this drive does not tell",
       1});
  return svg_figure(plot, "error as if exposed earlier or later");
}

std::string tried(const CameraCheck& check) {
  std::vector<std::vector<std::string>> rows = {{"what if", "error (px)"}};
  for (std::size_t i = 0; i < std::min(check.tried.size(), kTriedShown); ++i)
    rows.push_back({check.tried[i].what, fixed(check.tried[i].error_px, 2)});
  return "<figure>" + html_table(rows, true) + "<figcaption>of " + std::to_string(check.tried.size()) +
         " that were tried</figcaption></figure>\n";
}

/// Cameras on the car with their axes, seen along one axis of the body.
std::string rig_view(const Recording& recording, int right, int up, const std::string& caption) {
  constexpr const char* kAxis[] = {"x forward (m)", "y left (m)", "z up (m)"};
  constexpr const char* kColour[] = {"#d1495b", "#2e933c", "#1f6fb4"};
  constexpr double kLength_m = 0.6;
  SvgPlot plot{kAxis[right], kAxis[up], {}, {}, true};
  plot.height_px = 360;
  const auto flat = [&](const Eigen::Vector3d& p) { return Eigen::Vector2d(p[right], p[up]); };
  const Eigen::Vector3d low(-1, -0.95, 0.2), high(3.8, 0.95, 1.5);  // about a car
  plot.curves.push_back({{{low[right], low[up]},
                          {high[right], low[up]},
                          {high[right], high[up]},
                          {low[right], high[up]},
                          {low[right], low[up]}},
                         "#b6bec8",
                         ""});
  for (const RecordedCamera& camera : recording.cameras) {
    const Rigid3d& mounting = camera.calibration.body_from_sensor;
    for (int axis = 0; axis < 3; ++axis)
      plot.curves.push_back(
          {{flat(mounting.translation()), flat(mounting * Eigen::Vector3d(kLength_m * Eigen::Vector3d::Unit(axis)))},
           kColour[axis],
           "",
           axis == 2 ? 2.6 : 1.6});
    if (up == 1)  // beside each other; from the side they would lie over each other
      plot.texts.push_back({flat(mounting * Eigen::Vector3d(0, 0, 1.1 * kLength_m)), camera.calibration.name});
  }
  return svg_figure(plot, caption);
}

std::string way(const RigImages& images, int right, int up, const std::string& caption) {
  constexpr const char* kAxis[] = {"x of the first pose, forward (m)", "y, left (m)", "z, up (m)"};
  SvgPlot plot{kAxis[right], kAxis[up], {}, {}, up == 1};
  SvgCurve curve{{}, svg_colour(0), ""};
  for (const Frame& frame : images.scene.frames) {
    const Eigen::Vector3d at = frame.world_from_body.translation();
    curve.points.emplace_back(at[right], at[up]);
  }
  plot.curves.push_back(curve);
  return svg_figure(plot, caption);
}

std::string exposure(const RigImages& images) {
  SvgPlot plot{"time (s)", "brightness (0..1)", {}, {}, false, true};
  for (int c = 0; c < images.cameras(); ++c) {
    SvgCurve curve{{}, svg_colour(c), images.scene.rig[c].name};
    for (int f = 0; f < images.frames(); ++f) {
      const cv::Mat& grey = images.grey[c][f];
      if (grey.empty()) continue;
      cv::Mat root;  // grey is the square root of brightness
      grey.convertTo(root, CV_32F, 1 / 255.0);
      curve.points.emplace_back(1e-9 * static_cast<double>(images.scene.frames[f].t_ns - images.scene.frames[0].t_ns),
                                cv::mean(root.mul(root), images.usable[c][f])[0]);
    }
    plot.curves.push_back(curve);
  }
  return svg_figure(plot, "mean brightness of what is looked at: exposure over time");
}

}  // namespace

void write_preflight_page(const std::filesystem::path& folder, const Recording& recording, const RigImages& images,
                          const Preflight& preflight, ThreadPool& pool) {
  const LidarReturns lidar = load_lidar_returns(recording, images.scene, images.moving, pool);
  std::string body = verdicts(recording, preflight);
  for (int c = 0; c < images.cameras(); ++c) {
    const CameraCheck& check = preflight.cameras[c];
    body += "<h2>" + html_escape(check.name) + ": " + verdict_name(check.verdict) + "</h2>\n<p>" +
            html_escape(check.why) + "</p>\n";
    std::vector<std::string> figures = {picture(folder, recording, images, c, lidar)};
    if (!check.scan.empty()) figures.push_back(scan(check));
    if (!check.tried.empty()) figures.push_back(tried(check));
    body += row_of(figures);
  }
  if (recording.metric)
    body += "<h2>Cameras on the car</h2>\n" +
            row_of({rig_view(recording, 0, 1,
                             "from above; red: the camera's x (right), green: y (down), blue: z (where it looks)"),
                    rig_view(recording, 0, 2, "from its right side")});
  body += "<h2>The way</h2>\n" + row_of({way(images, 0, 1, "from above, to scale"),
                                         way(images, 0, 2, "from the side, heights exaggerated"), exposure(images)});
  write_file(folder / "index.html", html_page("Preflight", body));
}

}  // namespace redrive
