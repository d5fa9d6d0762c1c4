// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/objects_section.h"

#include <algorithm>
#include <functional>
#include <optional>
#include <sstream>
#include <utility>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "redrive/base/opencv_threads.h"
#include "redrive/edit/object_summary.h"
#include "redrive/image/image_io.h"
#include "redrive/perception/line_pen.h"
#include "redrive/report/html.h"
#include "redrive/report/plot.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/project_shutter.h"

namespace redrive {
namespace {

constexpr std::size_t kRowsShown = 100;   // rows of the table, at most
constexpr double kFarthestBox_m = 80;     // boxes drawn in images, at most so far away
constexpr double kClear_m = 20;           // nearer objects count as equally visible
constexpr double kParkedCounts = 0.2;     // weight of a parked object; a moving one has 1
constexpr int kFineBits = 4;              // fractional bits of pixels
constexpr std::size_t kLabelsAbove = 40;  // more would hide the tracks
const cv::Scalar kMoving(255, 140, 0), kParked(90, 170, 255), kShadow(0, 0, 0);  // RGB

/// An object where an image sees it.
struct Shown {
  const MovingObject* object;
  bool moves;
  Rigid3d world_from_box;
  double distance_m;
};

/// Returns the objects that an image may show, far ones first.
std::vector<Shown> shown_in(const Scene& scene, const View& view, const MovingObjects& objects) {
  const RigCamera& rig = scene.rig[view.camera];
  const Rigid3d camera_from_world = scene.world_from_camera(view).inverse(Eigen::Isometry);
  std::vector<Shown> shown;
  for (const bool moves : {false, true})
    for (const MovingObject& object : moves ? objects.objects() : objects.parked()) {
      const auto pose = object.world_from_box(scene.frames[view.frame].t_ns + rig.time_offset_ns);
      if (!pose) continue;
      const Eigen::Vector3d centre = camera_from_world * pose->translation();
      const auto pixel = rig.camera.project(centre);
      const bool inside = pixel && pixel->x() >= 0 && pixel->y() >= 0 &&
                          pixel->x() < rig.camera.width && pixel->y() < rig.camera.height;
      if (inside && centre.norm() <= kFarthestBox_m)
        shown.push_back({&object, moves, *pose, centre.norm()});
    }
  std::ranges::sort(shown, std::greater{}, &Shown::distance_m);
  return shown;
}

/// Draws the objects' boxes with a cross on their front, and their names.
void draw_boxes(const Scene& scene, const View& view, const std::vector<Shown>& all,
                Image8* image) {
  const Camera& camera = scene.rig[view.camera].camera;
  const ShutterPoses poses = scene.shutter_poses(view);
  const Rigid3d camera_from_world = poses.at(0.5).inverse(Eigen::Isometry);
  cv::Mat canvas(image->height, image->width, CV_8UC3, image->rgb.data());
  for (const Shown& shown : all) {
    std::vector<ImageLine> lines;
    LinePen pen(
        [&](const Eigen::Vector3d& in_world) -> std::optional<Eigen::Vector2d> {
          const auto seen = project_shutter(camera, poses, camera_from_world, in_world);
          if (!seen || seen->pixel.cwiseAbs().maxCoeff() > 1e4) return std::nullopt;
          return seen->pixel;
        },
        &lines);
    const Eigen::Vector3d& size_m = shown.object->size_m;
    draw_box("box", shown.object->type + " " + std::to_string(shown.object->id), size_m,
             shown.world_from_box, &pen);
    for (const auto& [from, to] : {std::pair(1, 7), std::pair(3, 5)}) {
      pen.begin("cross");
      pen.to(box_corner(shown.world_from_box, size_m, from));
      pen.to(box_corner(shown.world_from_box, size_m, to));
    }
    const cv::Scalar colour = shown.moves ? kMoving : kParked;
    for (const ImageLine& line : lines) {
      std::vector<cv::Point> fine;
      for (const Eigen::Vector2d& pixel : line.points)
        fine.emplace_back(cvRound((1 << kFineBits) * pixel.x()),
                          cvRound((1 << kFineBits) * pixel.y()));
      cv::polylines(canvas, fine, false, colour, 2, cv::LINE_AA, kFineBits);
    }
    for (const ImageLine& line : lines) {
      if (line.label.empty()) continue;
      const cv::Point where(cvRound(line.points[0].x()), cvRound(line.points[0].y()) - 4);
      for (const auto& [ink, thickness] : {std::pair(kShadow, 3), std::pair(colour, 1)})
        cv::putText(canvas, line.label, where, cv::FONT_HERSHEY_SIMPLEX, 0.45, ink, thickness,
                    cv::LINE_AA);
    }
  }
}

/// Returns the figure of the camera's image that shows the most objects; empty if none shows any.
std::string camera_figure(const std::filesystem::path& folder, const Recording& recording,
                          const RigImages& images, int camera) {
  SceneOptions options;
  options.cameras = {images.scene.rig[camera].name};
  options.downscale = images.factor[camera];
  const Scene scene = make_scene(recording, options);
  const View* best = nullptr;
  double most = 0;
  for (const View& view : scene.views) {
    double sum = 0;
    for (const Shown& shown : shown_in(scene, view, images.moving))
      sum += (shown.moves ? 1 : kParkedCounts) * std::min(1.0, kClear_m / shown.distance_m);
    if (sum <= most) continue;
    most = sum;
    best = &view;
  }
  if (!best) return "";
  Image8 image = load_view(scene, *best);
  draw_boxes(scene, *best, shown_in(scene, *best, images.moving), &image);
  image.alpha.clear();
  image.used.clear();
  const std::string name = "objects_" + scene.rig[0].name + ".jpg";
  write_image(folder / name, image);
  return html_figure(name, scene.rig[0].name + ", frame " +
                               std::to_string(scene.frames[best->frame].id) +
                               ": boxes of objects that move (orange) and of parked ones (blue), a "
                               "cross on their front");
}

std::string objects_table(const std::vector<ObjectSummary>& objects) {
  std::vector<std::vector<std::string>> rows = {
      {"object", "motion", "id", "boxes", "driven (m)", "nearest (m)", "images"}};
  for (std::size_t i = 0; i < std::min(objects.size(), kRowsShown); ++i) {
    const ObjectSummary& o = objects[i];
    rows.push_back({o.type, o.moves ? "moves" : "parked", std::to_string(o.id),
                    std::to_string(o.boxes), fixed(o.driven_m, 1), fixed(o.nearest_m, 1),
                    std::to_string(o.images)});
  }
  return html_table(rows, true) + (objects.size() > kRowsShown
                                       ? "<p>The first " + std::to_string(kRowsShown) + " of " +
                                             std::to_string(objects.size()) + ".</p>\n"
                                       : "");
}

/// Plots tracks, an outline of each box in the middle of its track, and the drive, from above.
std::string above_script(const RigImages& images, const std::string& name) {
  std::ostringstream drive, moving, outlines, labels;
  Eigen::AlignedBox2d shown;
  std::size_t labelled = 0;
  for (const PosedFrame& frame : images.scene.posed_frames()) {
    const Eigen::Vector2d at = frame.world_from_body.translation().head<2>();
    shown.extend(at);
    drive << at.x() << ' ' << at.y() << '\n';
  }
  const auto add = [&](const MovingObject& object, int colour) {
    const Rigid3d& middle = object.keys[object.keys.size() / 2].world_from_box;
    constexpr int kCorners[][2] = {{1, 1}, {1, -1}, {-1, -1}, {-1, 1}, {1, 1}};
    for (const auto& [x, y] : kCorners) {
      const Eigen::Vector3d corner =
          middle * Eigen::Vector3d(x * object.size_m.x() / 2, y * object.size_m.y() / 2, 0);
      outlines << corner.x() << ' ' << corner.y() << ' ' << colour << '\n';
      shown.extend(Eigen::Vector2d(corner.head<2>()));
    }
    outlines << '\n';
    if (labelled++ < kLabelsAbove)
      labels << "set label " << gnuplot_string(std::to_string(object.id)) << " at "
             << middle.translation().x() << ',' << middle.translation().y()
             << " left offset 0.6,0.6 font 'DejaVu Sans,15' front\n";
  };
  for (const MovingObject& object : images.moving.objects()) {
    for (const MovingObject::Key& key : object.keys) {
      const Eigen::Vector2d at = key.world_from_box.translation().head<2>();
      shown.extend(at);
      moving << at.x() << ' ' << at.y() << '\n';
    }
    moving << '\n';
    add(object, 1);
  }
  for (const MovingObject& object : images.moving.parked()) add(object, 0);
  std::ostringstream out;
  out << plot_preamble({name, "x of the first pose, forward (m)", "y, left (m)"}) << "set key off\n"
      << equal_axes(shown, 0.01 + 0.05 * shown.sizes().maxCoeff()) << labels.str()
      << "$drive << end\n"
      << drive.str() << "end\n$tracks << end\n"
      << moving.str() << (moving.str().empty() ? "NaN NaN\n" : "") << "end\n$boxes << end\n"
      << outlines.str() << "end\nplot $drive with lines lw 3 lc rgb '" << plot_colour(0)
      << "', $tracks with lines lw 3 lc rgb '#ff8c00'"
      << ", $boxes using 1:2:($3 == 1 ? 0xff8c00 : 0x5aaaff) with lines lw 2 lc rgb variable\n";
  return out.str();
}

}  // namespace

std::string objects_section(const std::filesystem::path& folder, const Recording& recording,
                            const RigImages& images) {
  std::vector<ObjectSummary> objects = summarize_objects(images.scene, images.moving);
  if (objects.empty()) return "";
  std::ranges::stable_sort(objects, [](const ObjectSummary& a, const ObjectSummary& b) {
    return std::pair(a.moves, a.images) > std::pair(b.moves, b.images);
  });
  std::string figures;
  for (int c = 0; c < images.cameras(); ++c) figures += camera_figure(folder, recording, images, c);
  return "<h2>Objects</h2>\n" + objects_table(objects) +
         html_row(
             figures + plot_figure(folder / "figures", "objects_above",
                                   above_script(images, "objects_above"),
                                   "from above, to scale: the drive (dark blue), tracks of objects "
                                   "that move (orange), parked ones (light blue)"),
             FigureSize::kLarge);
}

}  // namespace redrive
