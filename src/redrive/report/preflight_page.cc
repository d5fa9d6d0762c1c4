// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/preflight_page.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/image/image_io.h"

#include <sstream>

#include <opencv2/imgproc.hpp>

#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/perception/masks.h"
#include "redrive/report/html.h"
#include "redrive/report/objects_section.h"
#include "redrive/report/plot.h"
#include "redrive/scene/load_views.h"

namespace redrive {
namespace {

constexpr double kNearest_m = 2, kFarthest_m = 80;  // range of the LiDAR's colours
constexpr double kLidarAround_s = 0.06;             // about a revolution
constexpr std::size_t kLidarShown = 6000;           // points: more would hide the image
constexpr std::size_t kTriedShown = 6;

/// Returns "-8.8 ± 1.2", or "-" for an unobservable time offset.
std::string offset_text(const std::optional<TimeOffsetEstimate>& clock) {
  if (!clock) return "-";
  return fixed(clock->offset_ms, 1) +
         (std::isfinite(clock->sigma_ms) ? "\u00a0\u00b1\u00a0" + fixed(clock->sigma_ms, 1) : "");
}
std::string offset_by_images(const CameraCheck& check) {
  return offset_text(check.offset_observable ? std::optional(check.by_images()) : std::nullopt);
}

std::string verdicts(const Recording& recording, const Preflight& preflight) {
  std::vector<std::vector<std::string>> rows = {{"checked", "verdict", "why", "offset (ms)",
                                                 "by the LiDAR", "error (px)", "points",
                                                 "motion of points (px)", "edges"}};
  for (const CameraCheck& camera : preflight.cameras) {
    const bool any = !camera.tried.empty();
    rows.push_back({camera.name, verdict_name(camera.verdict), camera.why, offset_by_images(camera),
                    offset_text(camera.by_lidar), any ? fixed(camera.tried[0].error_px, 2) : "-",
                    std::to_string(camera.points), any ? fixed(camera.flow_px, 1) : "-",
                    camera.edges ? fixed(camera.edges->score(), 3) : "-"});
  }
  const auto of_all_cameras = [&](const std::string& name, Verdict verdict,
                                  const std::string& why) {
    rows.push_back({name, verdict_name(verdict), why, "", "", "", "", "", ""});
  };
  of_all_cameras("clock", preflight.clock.verdict, preflight.clock.why);
  for (const SharedCheck& check : preflight.shared)
    of_all_cameras(check.name, check.verdict, check.why);
  std::string out = "<h1>" + html_escape(recording.root.lexically_normal().filename().string()) +
                    "</h1>\n<h2>" + html_escape(preflight.headline()) + "</h2>\n";
  return out + html_table(rows, false) +
         "<p>Error: median distance of tracked points from their epipolar lines, by the "
         "calibration and the poses, between two images a few frames apart. Points are tracked "
         "without the calibration; points that contradict most of their image are dropped. The "
         "error depends on rotations and directions of motion, hardly on the camera's position "
         "(some decimetres). "
         "Offset: the time offset, added to the recorded one, with the least error, and, by the "
         "LiDAR, the one where LiDAR intensities (lane markings, signs, posts) correlate best with "
         "the images; +- one standard deviation. A dash: unobservable. Edges: how well steps of "
         "the "
         "LiDAR's depth lie on edges of the images, 0.5 by chance to 1; a dash: the LiDAR is too "
         "sparse.</p>\n";
}

/// Returns the middle one of the camera's frames; -1 if it has none.
int middle_frame(const RigImages& images, int camera) {
  std::vector<int> with_image;
  for (int f = 0; f < images.frames(); ++f)
    if (!images.grey[camera][f].empty()) with_image.push_back(f);
  return with_image.empty() ? -1 : with_image[with_image.size() / 2];
}

Mask static_mask_at(const RigImages& images, int camera, int frame) {
  const cv::Mat& usable = images.usable[camera][frame];
  const auto moving = images.moving_at(camera, frame);
  Mask mask = full_mask(usable.cols, usable.rows);
  for (int y = 0; y < mask.height; ++y)
    for (int x = 0; x < mask.width; ++x)
      mask.used[std::size_t(y) * mask.width + x] =
          images.may_be_static(camera, frame, Eigen::Vector2d(x, y), moving);
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

/// Draws each return at its position when it was measured, seen by the camera at the image's time;
/// near ones over far ones. Returns the number of points drawn.
int draw_lidar(const RigImages& images, int camera, int frame, const LidarReturns& lidar,
               Image8* image) {
  const std::int64_t t_ns =
      images.scene.frames[frame].t_ns + images.scene.rig[camera].time_offset_ns;
  const Rigid3d camera_from_world = images.world_from_camera[camera][frame].inverse();
  std::vector<std::pair<double, Eigen::Vector2d>> seen;
  LidarPoses poses(images.scene, lidar);
  for (std::size_t i = 0; i < lidar.n; ++i) {
    if (std::abs(lidar.t_ns[i] - t_ns) > static_cast<std::int64_t>(1e9 * kLidarAround_s)) continue;
    const Eigen::Vector3d in_camera = camera_from_world * poses.in_world(i);
    if (const auto pixel = images.camera(camera).project(in_camera))
      seen.emplace_back(in_camera.norm(), *pixel);
  }
  std::ranges::sort(seen, std::greater{}, [](const auto& s) { return s.first; });
  cv::Mat canvas(image->height, image->width, CV_8UC3, image->rgb.data());
  const std::size_t step = 1 + seen.size() / kLidarShown;
  for (std::size_t i = 0; i < seen.size(); i += step) {
    const auto& [distance_m, pixel] = seen[i];
    cv::circle(canvas, {cvRound(4 * pixel.x()), cvRound(4 * pixel.y())}, 6,
               distance_colour(distance_m), cv::FILLED, cv::LINE_AA, 2);
  }
  return static_cast<int>((seen.size() + step - 1) / step);
}

std::string camera_image(const std::filesystem::path& folder, const Recording& recording,
                         const RigImages& images, int camera, const LidarReturns& lidar) {
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
  Image8 tinted = overlay(image, static_mask_at(images, camera, frame));
  const int points = draw_lidar(images, camera, frame, lidar, &tinted);
  const std::string name = scene.rig[0].name + ".jpg";
  write_image(folder / name, tinted);
  return html_figure(
      name, "frame " + std::to_string(images.scene.frames[frame].id) +
                "; red: masked, with a margin; " +
                (points > 0 ? std::to_string(points) + " LiDAR points, 2 m (blue) to 80 m (red)"
                            : "no LiDAR"));
}

/// Plots the error over time offsets and, on a second axis, the correlation of the images with the
/// LiDAR's intensities.
std::string scan_script(const CameraCheck& check, const std::string& name) {
  constexpr const char *kError = "#1f4e8c", *kContrast = "#3a7d44";
  std::ostringstream out, plots;
  out << plot_preamble({name, "time offset (ms), added to the recorded one", "error (px)"})
      << "set autoscale xfix\nset yrange [0:*]\nset offsets 0, 0, graph "
         "0.05, 0\n";
  /// Adds a curve, and a line at its best offset.
  const auto add = [&](const std::string& data, const auto& points, auto value,
                       std::optional<double> best_ms, const std::string& title, const char* axes,
                       const char* colour) {
    const auto [low, high] = std::ranges::minmax(points, {}, value);
    const auto curve = [&](const std::string& name, const char* style, const std::string& of_key) {
      plots << (plots.str().empty() ? "" : ", ") << "$" << name << " axes " << axes
            << " with lines " << style << " lc rgb '" << colour << "' " << of_key;
    };
    out << "$" << data << " << end\n";
    for (const auto& p : points) out << p.offset_ms << ' ' << p.*value << '\n';
    out << "end\n";
    curve(data, "lw 3", "title " + gnuplot_string(title));
    if (!best_ms) return;
    out << "$" << data << "_best << end\n"
        << *best_ms << ' ' << std::min(0.0, low.*value) << '\n'
        << *best_ms << ' ' << high.*value << "\nend\n";
    curve(data + "_best", "lw 2 dt 2", "notitle");
  };
  if (check.scan.empty())
    out << "unset ytics\nset yrange [0:1]\n";
  else
    add("scan", check.scan, &ScanPoint::error_px,
        check.offset_observable ? std::optional(check.offset_ms) : std::nullopt,
        check.offset_observable ? "least error at " + offset_by_images(check) + " ms"
                                : "error: no clear minimum",
        "x1y1", kError);
  if (!check.contrast.empty()) {
    const auto [low, high] = std::ranges::minmax(check.contrast, {}, &ContrastPoint::correlation);
    out << "set border 11\nset y2tics\nset y2label 'correlation with the LiDAR'\nset y2range ["
        << std::min(0.0, low.correlation) << ':' << std::max(1.4 * high.correlation, 0.01) << "]\n";
    add("contrast", check.contrast, &ContrastPoint::correlation,
        check.by_lidar ? std::optional(check.by_lidar->offset_ms) : std::nullopt,
        check.by_lidar ? "LiDAR correlates best at " + offset_text(check.by_lidar) + " ms"
                       : "LiDAR: no clear peak",
        "x1y2", kContrast);
  }
  out << "plot " << plots.str() << '\n';
  return out.str();
}

std::string hypotheses_table(const CameraCheck& check) {
  std::vector<std::vector<std::string>> rows = {{"hypothesis", "error (px)"}};
  for (std::size_t i = 0; i < std::min(check.tried.size(), kTriedShown); ++i)
    rows.push_back({check.tried[i].what, fixed(check.tried[i].error_px, 2)});
  return "<figure>" + html_table(rows, true) + "<figcaption>best of " +
         std::to_string(check.tried.size()) + " hypotheses</figcaption></figure>\n";
}

/// Plots the cameras with their axes, seen along one axis of the body.
std::string rig_script(const Recording& recording, int right, int up, const std::string& name) {
  constexpr const char* kAxis[] = {"x forward (m)", "y left (m)", "z up (m)"};
  constexpr const char* kColour[] = {"#c2281a", "#2e933c",
                                     "#1f6fb4"};  // axes are red, green, blue by convention
  constexpr double kLength_m = 0.6, kAround_m = 0.4, kLetter_m = 0.1, kLine_m = 0.24;
  const Eigen::Vector3d low(-1, -0.95, 0.2), high(3.8, 0.95, 1.5);  // about a car
  const auto flat = [&](const Eigen::Vector3d& p) { return Eigen::Vector2d(p[right], p[up]); };
  Eigen::AlignedBox2d shown(flat(low));
  shown.extend(flat(high));
  std::ostringstream data, labels;
  std::vector<Eigen::Vector2d> labelled;
  std::size_t letters = 0;
  for (const RecordedCamera& camera : recording.cameras)
    letters = std::max(letters, camera.calibration.name.size());
  const double length_m = kLetter_m * static_cast<double>(letters);
  for (const RecordedCamera& camera : recording.cameras) {
    const Rigid3d& body_from_camera = camera.calibration.body_from_sensor;
    const Eigen::Vector2d at = flat(body_from_camera.translation());
    shown.extend(at);
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector2d end =
          flat(body_from_camera * Eigen::Vector3d(kLength_m * Eigen::Vector3d::Unit(axis)));
      shown.extend(end);
      data << at.x() << ' ' << at.y() << ' ' << end.x() - at.x() << ' ' << end.y() - at.y() << ' '
           << axis << '\n';
    }
    if (up != 1) continue;  // from the side labels would overlap
    Eigen::Vector2d label = flat(body_from_camera * Eigen::Vector3d(0, 0, 1.1 * kLength_m));
    const auto over_another = [&](const Eigen::Vector2d& other) {
      return std::abs(label.x() - other.x()) < length_m &&
             std::abs(label.y() - other.y()) < 0.9 * kLine_m;
    };
    while (std::ranges::any_of(labelled, over_another)) label.y() -= kLine_m;
    labelled.push_back(label);
    shown.extend(Eigen::Vector2d(label + Eigen::Vector2d(length_m, 0)));
    labels << "set label " << gnuplot_string(camera.calibration.name) << " at " << label.x() << ','
           << label.y() << " left font 'DejaVu Sans,16' front\n";
  }
  std::ostringstream out;
  out << plot_preamble({name, kAxis[right], kAxis[up], 600}) << "set key off\n"
      << equal_axes(shown, kAround_m) << labels.str() << "set object 1 rectangle from "
      << low[right] << ',' << low[up] << " to " << high[right] << ',' << high[up]
      << " behind fillstyle empty border lc rgb '#b6bec8' lw 3\n$axes << end\n"
      << data.str() << "end\nplot ";
  for (int axis = 0; axis < 3; ++axis)
    out << (axis ? ", " : "") << "$axes using 1:2:($5 == " << axis
        << " ? $3 : NaN):4 with vectors nohead lw " << (axis == 2 ? 5 : 3) << " lc rgb '"
        << kColour[axis] << "'";
  out << '\n';
  return out.str();
}

std::string drive_script(const RigImages& images, int right, int up, const std::string& name) {
  constexpr const char* kAxis[] = {"x of the first pose, forward (m)", "y, left (m)", "z, up (m)"};
  std::ostringstream data;
  Eigen::AlignedBox2d shown;
  for (const PosedFrame& frame : images.scene.posed_frames()) {
    const Eigen::Vector3d position = frame.world_from_body.translation();
    const Eigen::Vector2d at(position[right], position[up]);
    shown.extend(at);
    data << at.x() << ' ' << at.y() << '\n';
  }
  std::ostringstream out;
  out << plot_preamble({name, kAxis[right], kAxis[up]}) << "set key off\n"
      << (up == 1 ? equal_axes(shown, 0.01 + 0.05 * shown.sizes().maxCoeff()) : "")
      << "$way << end\n"
      << data.str() << "end\nplot $way with linespoints lw 3 pt 7 ps 0.4 lc rgb '" << plot_colour(0)
      << "'\n";
  return out.str();
}

std::string exposure_script(const RigImages& images, const std::string& name) {
  constexpr int kInKey = 8;  // photographs may have a camera each
  const bool in_key = images.cameras() <= kInKey;
  std::ostringstream out, plots;
  out << plot_preamble({name, "time (s)", "brightness (0..1)",
                        height_with_cameras(in_key ? images.cameras() : 0)})
      << (in_key ? "" : "set key off\n")
      << "set autoscale xfix\nset yrange [0:*]\nset offsets 0, 0, graph 0.05, 0\n";
  for (int c = 0; c < images.cameras(); ++c) {
    out << "$camera" << c << " << end\n";
    for (int f = 0; f < images.frames(); ++f) {
      const cv::Mat& grey = images.grey[c][f];
      if (grey.empty()) continue;
      cv::Mat root;  // grey is the square root of brightness
      grey.convertTo(root, CV_32F, 1 / 255.0);
      out << 1e-9 * static_cast<double>(images.scene.frames[f].t_ns - images.scene.frames[0].t_ns)
          << ' ' << cv::mean(root.mul(root), images.usable[c][f])[0] << '\n';
    }
    out << "end\n";
    plots << (c ? ", " : "") << "$camera" << c << " with linespoints lw 3 pt 7 ps 0.4 lc rgb '"
          << plot_colour(c) << "' title " << gnuplot_string(images.scene.rig[c].name);
  }
  out << "plot " << plots.str() << '\n';
  return out.str();
}

}  // namespace

void write_preflight_page(const std::filesystem::path& folder, const Recording& recording,
                          const RigImages& images, const LidarReturns& lidar,
                          const Preflight& preflight) {
  const auto drawn = [&](const std::string& name, const std::string& script,
                         const std::string& caption) {
    return plot_figure(folder / "figures", name, script, caption);
  };
  const Progress progress("drawing the page");
  std::string body = verdicts(recording, preflight);
  for (int c = 0; c < images.cameras(); ++c) {
    const CameraCheck& check = preflight.cameras[c];
    body += "<h2>" + html_escape(check.name) + ": " + verdict_name(check.verdict) + "</h2>\n<p>" +
            html_escape(check.why) + "</p>\n";
    std::string figures = camera_image(folder, recording, images, c, lidar);
    if (const std::string name = "scan_" + check.name;
        !check.scan.empty() || !check.contrast.empty())
      figures += drawn(name, scan_script(check, name),
                       check.contrast.empty()
                           ? "error over time offsets"
                           : "over time offsets: error (blue), correlation with the LiDAR (green)");
    if (!check.tried.empty()) figures += hypotheses_table(check);
    body += html_row(figures, FigureSize::kLarge);
  }
  body += objects_section(folder, recording, images);
  if (recording.metric)
    body +=
        "<h2>Extrinsics</h2>\n" +
        html_row(
            drawn(
                "rig_above", rig_script(recording, 0, 1, "rig_above"),
                "from above; the camera's axes: x (right) red, y (down) green, z (forward) blue") +
                drawn("rig_side", rig_script(recording, 0, 2, "rig_side"), "from the right side"),
            FigureSize::kLarge);
  body +=
      "<h2>Trajectory</h2>\n" +
      html_row(drawn("way_above", drive_script(images, 0, 1, "way_above"), "from above, to scale") +
                   drawn("way_side", drive_script(images, 0, 2, "way_side"),
                         "from the side, heights exaggerated") +
                   drawn("exposure", exposure_script(images, "exposure"),
                         "exposure: mean brightness of the unmasked pixels over time"),
               FigureSize::kLarge);
  write_file(folder / "index.html", html_page("Preflight", body));
}

}  // namespace redrive
