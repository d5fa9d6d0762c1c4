// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/overlay.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <optional>

#include "redrive/perception/moving_file.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/view/traffic.h"

namespace redrive::view {
namespace {

constexpr double kFrustumDepth_m = 0.6;
constexpr double kOwnFrustum_m = 0.05;  // a frustum this near to the viewer is the camera's own
constexpr std::size_t kKeptRevolutions = 4;

/// Returns a pen that draws in the coordinates of OverlayLine.
LinePen pen_of(const Placement& placement, std::vector<OverlayLine>* lines) {
  const Rigid3d camera_from_world = placement.world_from_camera.inverse(Eigen::Isometry);
  return {[&camera = placement.camera,
           camera_from_world](const Eigen::Vector3d& in_world) -> std::optional<Eigen::Vector2d> {
            const Eigen::Vector3d in_camera = camera_from_world * in_world;
            const auto pixel = in_camera.norm() > 1e-3 ? camera.project(in_camera) : std::nullopt;
            if (!pixel) return std::nullopt;
            const Eigen::Vector2d at((pixel->x() + 0.5) / camera.width,
                                     (pixel->y() + 0.5) / camera.height);
            if (at.minCoeff() > -0.5 && at.maxCoeff() < 1.5) return at;
            return std::nullopt;
          },
          lines};
}

/// Returns the direction of a pixel, or of the nearest pixel towards the principal point that has
/// one.
std::optional<Eigen::Vector3d> direction_near(const Camera& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d middle(camera.cx, camera.cy);
  for (double share = 1; share > 0; share -= 0.05)
    if (const auto direction = camera.unproject(middle + share * (pixel - middle)))
      return direction;
  return std::nullopt;
}

void draw_frustum(const Camera& camera, const Rigid3d& world_from_camera, const std::string& name,
                  LinePen* pen) {
  const double right = camera.width - 0.5, lower = camera.height - 0.5;
  const std::array<Eigen::Vector2d, 4> corners = {
      Eigen::Vector2d(-0.5, -0.5), {right, -0.5}, {right, lower}, {-0.5, lower}};
  const Eigen::Vector3d centre = world_from_camera.translation();
  const auto at = [&](const Eigen::Vector2d& pixel) -> std::optional<Eigen::Vector3d> {
    const auto direction = direction_near(camera, pixel);
    if (!direction) return std::nullopt;
    return world_from_camera * (kFrustumDepth_m * *direction);
  };
  for (std::size_t i = 0; i < 4; ++i) {
    pen->begin("frustum", i == 0 ? name : "");
    pen->to(centre);
    for (int step = 0; step <= 4; ++step)
      if (const auto point = at(corners[i] + 0.25 * step * (corners[(i + 1) % 4] - corners[i])))
        pen->to(*point);
  }
}

}  // namespace

std::vector<OverlayLine> Overlay::lines(const Placement& placement, const Overlays& which) const {
  std::vector<OverlayLine> lines;
  LinePen pen = pen_of(placement, &lines);
  if (which.trajectory) {
    pen.begin("trajectory");
    for (const PosedFrame& frame : run_.scene.posed_frames())
      pen.to(frame.world_from_body.translation());
  }
  if (which.frusta)
    for (const RigCamera& camera : run_.scene.rig) {
      const Rigid3d world_from_camera = placement.world_from_body * camera.body_from_sensor;
      if ((world_from_camera.translation() - placement.world_from_camera.translation()).norm() >
          kOwnFrustum_m)
        draw_frustum(camera.camera, world_from_camera, camera.name, &pen);
    }
  if (which.boxes) {
    for (const FrameFile& file : run_.recording.box_files)
      if (file.frame_id == placement.frame)
        for (const Box& box : run_.recording.reader->read_boxes(file))
          draw_box("box", box.type + " " + std::to_string(box.object_id), box.size_m,
                   run_.scene.world_from_body(box.t_ns) * box.body_from_box, &pen);
    for (const MovingObject& object : run_.moving.objects()) {
      const auto world_from_box = object.world_from_box(placement.t_ns);
      if (object.type == kFound && world_from_box)
        draw_box("box", object.type + " " + std::to_string(object.id), object.size_m,
                 *world_from_box, &pen);
    }
  }
  return lines;
}

std::vector<OverlayLine> object_lines(const Placement& placement, const MovingObject& object) {
  std::vector<OverlayLine> lines;
  const auto world_from_box = object.world_from_box(placement.t_ns);
  if (!world_from_box) return lines;
  LinePen pen = pen_of(placement, &lines);
  draw_box("object", object.type + " " + std::to_string(object.id), object.size_m, *world_from_box,
           &pen);
  if (const auto handle = handle_in_box(placement, *world_from_box, object.size_m)) {
    pen.begin("handle");
    pen.to(*world_from_box * Eigen::Vector3d(0, 0, handle->z()));
    pen.to(*world_from_box * *handle);
  }
  return lines;
}

Overlay::Overlay(const Run& run) : run_(run) {
  if (!run.recording.lidars.empty())
    for (const FrameFile& file : run.recording.lidar_files)
      if (run.scene.frame_index(file.frame_id) >= 0) cloud_files_.push_back(&file);
}

Overlay::Points Overlay::read(const FrameFile& file) const {
  Points points;
  for (const LidarPoint& point : run_.recording.read_lidar(file))
    points.push_back(
        (run_.scene.world_from_body(point.t_ns) * point.in_body_m.cast<double>()).cast<float>());
  return points;
}

bool Overlay::read_cloud() {
  if (cloud_read_ == cloud_files_.size()) return false;
  const Points points = read(*cloud_files_[cloud_read_++]);
  const std::size_t most = std::max<std::size_t>(1, kCloudPoints / cloud_files_.size());
  const std::size_t step = (points.size() + most - 1) / most;
  for (std::size_t i = 0; i < points.size(); i += step) cloud_.push_back(points[i]);
  return true;
}

std::shared_ptr<const Overlay::Points> Overlay::revolution(std::int64_t frame) {
  for (auto known = revolutions_.begin(); known != revolutions_.end(); ++known)
    if (known->first == frame) {
      revolutions_.splice(revolutions_.begin(), revolutions_, known);
      return revolutions_.front().second;
    }
  auto points = std::make_shared<Points>();
  if (!run_.recording.lidars.empty())
    for (const FrameFile& file : run_.recording.lidar_files)
      if (file.frame_id == frame) std::ranges::copy(read(file), std::back_inserter(*points));
  revolutions_.emplace_front(frame, std::move(points));
  if (revolutions_.size() > kKeptRevolutions) revolutions_.pop_back();
  return revolutions_.front().second;
}

std::string Overlay::points(const RenderJob& job, const Overlays& which,
                            const RenderedScan* rendered) {
  const Placement& placement = job.placement();
  const RenderedImage& image = job.image();
  const Rigid3d camera_from_world = placement.world_from_camera.inverse(Eigen::Isometry);
  std::string bytes;
  const auto add = [&](const Eigen::Vector3f& in_world, char kind,
                       std::optional<std::uint8_t> colour = {}) {
    const Eigen::Vector3d in_camera = camera_from_world * in_world.cast<double>();
    const double range_m = in_camera.norm();
    if (range_m < 0.1) return;
    const auto pixel = placement.camera.project(in_camera);
    if (!pixel) return;
    const double u = (pixel->x() + 0.5) / placement.camera.width,
                 v = (pixel->y() + 0.5) / placement.camera.height;
    if (!(u >= 0 && u < 1 && v >= 0 && v < 1)) return;
    const std::size_t at = static_cast<std::size_t>(v * image.height) * image.width +
                           static_cast<std::size_t>(u * image.width);
    // Behind a surface: by more than the depth of a thin splat and of the surface's slope.
    if (image.opacity[at] > 0.5f && range_m > 1.05 * image.depth[at] + 0.3) return;
    const auto put = [&](double share) {
      const auto value = static_cast<std::uint16_t>(65535 * share);
      bytes += static_cast<char>(value & 255);
      bytes += static_cast<char>(value >> 8);
    };
    put(u);
    put(v);
    bytes += static_cast<char>(colour.value_or(range_colour(range_m)));
    bytes += kind;
  };
  // Adds points spread over all of `n`, so that the first ones are evenly distributed: by a step
  // coprime to their number, since it is a larger prime.
  constexpr std::size_t kPrime = 1000003;
  static_assert(kPrime > 2 * kCloudPoints && kPrime > kMostRays);
  const auto add_spread = [&](std::size_t n, const auto& add_one) {
    const std::size_t most = bytes.size() + 6 * kPointsOfImage;
    for (std::size_t i = 0; i < n && bytes.size() < most; ++i) add_one(i * kPrime % n);
  };
  if (which.cloud) add_spread(cloud_.size(), [&](std::size_t i) { add(cloud_[i], 0); });
  if (which.lidar)
    for (const auto of_frame = revolution(placement.frame);
         const Eigen::Vector3f& point : *of_frame)
      add(point, 1);
  if (rendered)
    add_spread(rendered->in_world.size(),
               [&](std::size_t i) { add(rendered->in_world[i], 2, rendered->colour[i]); });
  return bytes;
}

std::string mask_runs(const Mask& mask) {
  std::string bytes;
  const auto put = [&](std::size_t length) {
    for (; length > 127; length >>= 7) bytes += static_cast<char>(128 | (length & 127));
    bytes += static_cast<char>(length);
  };
  bool used = true;
  std::size_t length = 0;
  for (const std::uint8_t pixel : mask.used) {
    if ((pixel != 0) == used) {
      ++length;
    } else {
      put(length);
      used = !used;
      length = 1;
    }
  }
  put(length);
  return bytes;
}

}  // namespace redrive::view
