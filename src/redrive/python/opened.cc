// SPDX-License-Identifier: Apache-2.0
#include "redrive/python/opened.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/base/evenly_spaced.h"
#include "redrive/perception/masks.h"
#include "redrive/render/recorded_lidar.h"
#include "redrive/render/view_pose.h"
#include "redrive/scene/load_views.h"

namespace redrive::python {
namespace {

RigCamera rig_camera(const CameraCalibration& calibration) {
  return {calibration.name,
          make_camera(calibration),
          make_camera(calibration),
          calibration.body_from_sensor,
          calibration.time_offset_ns,
          calibration.readout_ns,
          calibration.readout_by_column};
}

}  // namespace

NamedCamera::NamedCamera(const CameraCalibration& calibration)
    : NamedCamera(rig_camera(calibration), calibration) {}

NamedCamera::NamedCamera(const RigCamera& rig, const CameraCalibration& calibration) : rig(rig) {
  const Camera& camera = rig.camera;
  intrinsics = {{"fx", camera.fx}, {"fy", camera.fy}, {"cx", camera.cx}, {"cy", camera.cy}};
  if (camera.info().name != calibration.model) return;  // undistorted
  std::size_t at = 4;
  for (const auto* parameters : {&camera.info().distortion, &camera.info().other})
    for (const CameraParameter& parameter : *parameters)
      intrinsics.emplace_back(parameter.name, calibration.parameters.at(at++));
}

Opened::Opened(std::shared_ptr<const Run> run, int threads)
    : run_(std::move(run)), pool_(threads > 0 ? threads : hardware_threads()) {
  for (const RigCamera& rig : run_->scene.rig)
    cameras_.emplace_back(rig, run_->recording.find_camera(rig.name)->calibration);
}

int Opened::camera_index(const std::string& name) const {
  const int index = scene().camera_index(name);
  if (index < 0) throw UsageError("camera", name, unknown_camera(name, scene().rig));
  return index;
}

std::int64_t Opened::frame_ns(std::int64_t frame) const {
  const auto& all = scene().trajectory;
  const auto found = std::ranges::find(all, frame, &FramePose::id);
  if (found == all.end())
    throw UsageError("frame", std::to_string(frame), unknown_frame(frame, scene()));
  return found->t_ns;
}

std::int64_t Opened::checked_time(std::int64_t t_ns) const {
  constexpr std::int64_t kBeyond_ns = 1'000'000'000;
  const std::int64_t first_ns = scene().trajectory.front().t_ns,
                     last_ns = scene().trajectory.back().t_ns;
  if (t_ns < first_ns - kBeyond_ns || t_ns > last_ns + kBeyond_ns)
    throw UsageError("time_ns", std::to_string(t_ns),
                     "must be at most a second before " + std::to_string(first_ns) + " or after " +
                         std::to_string(last_ns));
  return t_ns;
}

View Opened::view_of(int camera, std::int64_t frame) const {
  const int index = scene().frame_index(frame);
  if (index < 0) throw UsageError("frame", std::to_string(frame), unknown_frame(frame, scene()));
  const auto found = std::ranges::find_if(scene().views, [&](const View& view) {
    return view.camera == camera && view.frame == index;
  });
  return found == scene().views.end() ? View{camera, index} : *found;
}

const View& Opened::image_of(int camera, std::int64_t frame) const {
  const View view = view_of(camera, frame);
  for (const View& other : scene().views)
    if (other.camera == view.camera && other.frame == view.frame) return other;
  throw UsageError("frame", std::to_string(frame),
                   "has no image of camera " + scene().rig[camera].name);
}

std::shared_ptr<const RayTable> Opened::table(int camera) {
  const std::lock_guard lock(cache_mutex_);
  auto& table = tables_[camera];
  if (!table) {
    const std::lock_guard working(pool_mutex_);
    table = std::make_shared<const RayTable>(make_ray_table(scene().rig[camera].camera, pool_));
  }
  return table;
}

ImageRays Opened::rays(int camera, const View& view) {
  const std::shared_ptr<const RayTable> table = this->table(camera);
  const RigCamera& rig = scene().rig[camera];
  const ShutterPoses poses = scene().shutter_poses(view, {});
  const std::int64_t middle_ns = scene().exposed_ns(view);
  const auto width = static_cast<std::size_t>(table->width),
             height = static_cast<std::size_t>(table->height);
  ImageRays out{table->width, table->height, rig.readout_by_column, {}, {}, {}, {}};
  const std::size_t lines = out.by_column ? width : height;
  std::vector<PlainPose> pose;
  for (std::size_t line = 0; line < lines; ++line) {
    const double part = row_fraction(static_cast<double>(line), static_cast<int>(lines));
    pose.push_back(plain(poses.at(part)));
    out.t_ns.push_back(middle_ns +
                       std::llround((part - 0.5) * static_cast<double>(rig.readout_ns)));
    for (const double x : pose.back().translation) out.origin.push_back(static_cast<float>(x));
  }
  out.direction.resize(3 * width * height);
  out.is_ray.resize(width * height);
  const std::lock_guard working(pool_mutex_);
  constexpr std::size_t kRays = 16384;
  pool_.run_ranges(table->pixel.size(), kRays, [&](std::size_t begin, std::size_t end) {
    for (std::size_t entry = begin; entry < end; ++entry) {
      const std::size_t pixel = table->pixel[entry],
                        line = out.by_column ? pixel % width : pixel / width;
      double in_camera[3];
      for (int k = 0; k < 3; ++k) in_camera[k] = table->direction[3 * entry + k];
      for (int k = 0; k < 3; ++k)
        out.direction[3 * pixel + k] = static_cast<float>(rotated(pose[line], in_camera, k));
      out.is_ray[pixel] = 1;
    }
  });
  return out;
}

const std::optional<ScanStructure>& Opened::structure() {
  const std::lock_guard lock(cache_mutex_);
  if (!structure_is_known_) structure_ = recorded_structure(run_->recording, &why_no_structure_);
  structure_is_known_ = true;
  return structure_;
}

Points Opened::scan(std::int64_t frame, Axes axes, bool lost) {
  const Recording& recording = run_->recording;
  if (recording.lidars.empty())
    throw UsageError("frame", std::to_string(frame), "the recording has no LiDAR");
  std::vector<LidarPoint> points;
  bool is_there = false;
  for (const FrameFile& file : recording.scans_of(0)) {
    if (file.frame_id != frame) continue;
    is_there = true;
    const std::vector<LidarPoint> more = recording.read_lidar(file);
    points.insert(points.end(), more.begin(), more.end());
  }
  if (!is_there) throw UsageError("frame", std::to_string(frame), "has no LiDAR scan");
  Points out;
  out.position_m.resize(3 * points.size());
  const Rigid3d lidar_from_body = recording.lidars[0].body_from_lidar.inverse(Eigen::Isometry);
  {
    const std::lock_guard working(pool_mutex_);
    pool_.run_ranges(points.size(), 1 << 14, [&](std::size_t begin, std::size_t end) {
      Rigid3d axes_from_body = axes == Axes::kSensor ? lidar_from_body : Rigid3d::Identity();
      for (std::size_t i = begin; i < end; ++i) {
        if (axes == Axes::kWorld && (i == begin || points[i].t_ns != points[i - 1].t_ns))
          axes_from_body = scene().world_from_body(points[i].t_ns);
        const Eigen::Vector3d at = axes_from_body * points[i].in_body_m.cast<double>();
        for (int k = 0; k < 3; ++k) out.position_m[3 * i + k] = static_cast<float>(at[k]);
      }
    });
  }
  std::uint16_t largest = 0;
  for (const LidarPoint& point : points) largest = std::max(largest, point.intensity);
  const auto scale = static_cast<float>(intensity_scale(largest));
  for (const LidarPoint& point : points) {
    out.intensity.push_back(point.intensity / scale);
    out.t_ns.push_back(point.t_ns);
    out.ring.push_back(point.ring);
  }
  if (!lost) return out;
  if (!structure()) {
    out.why_unknown = why_no_structure_;
    return out;
  }
  const LostRays rays =
      lost_rays(points, recording.lidars[0].body_from_lidar, *structure_, &out.why_unknown);
  out.knows_lost = out.why_unknown.empty();
  for (const Eigen::Vector3f& direction : rays.direction)
    out.lost_direction.insert(out.lost_direction.end(), direction.data(), direction.data() + 3);
  out.lost_t_ns = rays.t_ns;
  out.lost_ring = rays.beam;
  return out;
}

const MovingObjects& Opened::objects() {
  const std::lock_guard lock(cache_mutex_);
  if (!objects_)
    objects_ = run_->field() ? run_->moving : read_moving_objects(run_->recording, scene());
  return *objects_;
}

std::vector<std::uint8_t> Opened::mask(const View& view, bool moving) {
  const Camera& camera = scene().rig[view.camera].camera;
  Mask of_camera = full_mask(camera.width, camera.height);
  if (run_->field()) {
    const std::lock_guard lock(cache_mutex_);
    if (!masks_) masks_ = read_exclusions(*run_).masks;
    if (!masks_->empty()) of_camera = (*masks_)[view.camera];
  }
  Mask mask = view_mask(scene(), view, of_camera, moving ? objects() : MovingObjects());
  if (!view.image.empty())
    if (const Image8 image = load_view(scene(), view); !image.used.empty())
      for (std::size_t i = 0; i < mask.used.size(); ++i) mask.used[i] &= image.used[i];
  return std::move(mask.used);
}

}  // namespace redrive::python
