// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/rig/rig_model.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/lidar_sensor.h"

namespace redrive {
namespace {

/// Time derivative of a trajectory at a frame.
struct Slope {
  Eigen::Vector3d velocity, angular_velocity;  ///< m/s in the world; rad/s in the body
};

Slope between_frames(const std::vector<PosedFrame>& frames, int a) {
  const double h = static_cast<double>(frames[a + 1].t_ns - frames[a].t_ns) * 1e-9;
  return {
      (frames[a + 1].world_from_body.translation() - frames[a].world_from_body.translation()) / h,
      so3_log(frames[a].world_from_body.linear().transpose() *
              frames[a + 1].world_from_body.linear()) /
          h};
}

/// Slope of the parabola through the frame and its neighbours, or through the three frames at an
/// end; of the line through two frames if there are no more.
Slope slope_at(const std::vector<PosedFrame>& frames, int frame) {
  const int last = static_cast<int>(frames.size()) - 1;
  if (last == 1) return between_frames(frames, 0);
  const int middle = std::clamp(frame, 1, last - 1);
  const Slope before = between_frames(frames, middle - 1), after = between_frames(frames, middle);
  const double h_before = static_cast<double>(frames[middle].t_ns - frames[middle - 1].t_ns),
               h_after = static_cast<double>(frames[middle + 1].t_ns - frames[middle].t_ns),
               all = h_before + h_after;
  // The slope changes evenly from the middle of the first interval to the middle of the second.
  const double at = frame < middle   ? -h_before / all
                    : frame > middle ? 1 + h_after / all
                                     : h_before / all;
  return {before.velocity + at * (after.velocity - before.velocity),
          before.angular_velocity + at * (after.angular_velocity - before.angular_velocity)};
}

/// The cubic from 0 with slope `from` to `end` with slope `to` in h seconds, at u in 0..1.
class Hermite {
 public:
  Hermite(const Eigen::Vector3d& end, const Eigen::Vector3d& from, const Eigen::Vector3d& to,
          double h)
      : h_(h),
        linear_(h * from),
        quadratic_(3 * end - h * (2 * from + to)),
        cubic_(h * (from + to) - 2 * end) {}
  Eigen::Vector3d value(double u) const { return u * (linear_ + u * (quadratic_ + u * cubic_)); }
  Eigen::Vector3d slope(double u) const {
    return (linear_ + u * (2 * quadratic_ + 3 * u * cubic_)) / h_;
  }

 private:
  double h_;
  Eigen::Vector3d linear_, quadratic_, cubic_;
};

}  // namespace

LocalMotion RigModel::motion_at(std::int64_t t_ns) const {
  LocalMotion motion = smooth_motion_at(t_ns);
  // Removes the present corrections, which are linear in time, so that changed ones can be added.
  const int a = motion.segment;
  const Vector6d slope = (corrections[a + 1] - corrections[a]) / motion.duration_s,
                 added = corrections[a] + motion.weight * motion.duration_s * slope;
  const Rigid3d now = rigid_from_vector(added);
  const Eigen::Vector3d rho = added.head<3>(), rate = now.linear() * motion.angular_velocity,
                        own_rate =
                            now.linear() * so3_right_jacobian(added.tail<3>()) * slope.tail<3>();
  motion.velocity = now.linear() * motion.velocity + rho.cross(rate - own_rate) - slope.head<3>();
  motion.angular_velocity = rate - own_rate;
  motion.world_from_body = motion.world_from_body * now.inverse(Eigen::Isometry);
  return motion;
}

LocalMotion RigModel::smooth_motion_at(std::int64_t t_ns) const {
  const auto after =
      std::upper_bound(initial_frames.begin(), initial_frames.end(), t_ns,
                       [](std::int64_t t, const PosedFrame& f) { return t < f.t_ns; });
  LocalMotion motion;
  motion.segment = static_cast<int>(
      std::clamp<std::ptrdiff_t>(after - initial_frames.begin() - 1, 0,
                                 static_cast<std::ptrdiff_t>(initial_frames.size()) - 2));
  // The frames that the slopes at both ends need.
  const int first = std::max(0, motion.segment - 1),
            end = std::min(static_cast<int>(initial_frames.size()),
                           std::max(motion.segment + 3, first + 3));
  const int start = std::max(0, std::min(first, end - 3));
  std::vector<PosedFrame> frames(initial_frames.begin() + start, initial_frames.begin() + end);
  for (int f = start; f < end; ++f)
    frames[f - start].world_from_body =
        initial_frames[f].world_from_body * rigid_from_vector(corrections[f]);
  const int here = motion.segment - start;
  const PosedFrame &a = frames[here], &b = frames[here + 1];
  const double h = static_cast<double>(b.t_ns - a.t_ns) * 1e-9;
  motion.duration_s = h;
  motion.weight = static_cast<double>(t_ns - a.t_ns) * 1e-9 / h;
  const Slope at_a = slope_at(frames, here), at_b = slope_at(frames, here + 1);
  if (motion.weight < 0 || motion.weight > 1) {
    const bool before = motion.weight < 0;
    const double beyond_s = (before ? motion.weight : motion.weight - 1) * h;
    const Slope& slope = before ? at_a : at_b;
    const Eigen::Matrix3d rotation = so3_exp(slope.angular_velocity * beyond_s);
    motion.world_from_body = (before ? a : b).world_from_body;
    motion.velocity =
        rotation.transpose() * motion.world_from_body.linear().transpose() * slope.velocity;
    motion.world_from_body.translation() += slope.velocity * beyond_s;
    motion.world_from_body.linear() = motion.world_from_body.linear() * rotation;
    motion.angular_velocity = slope.angular_velocity;
    return motion;
  }
  const Hermite position(b.world_from_body.translation() - a.world_from_body.translation(),
                         at_a.velocity, at_b.velocity, h);
  // Rotation vectors relative to a. Their rate at b is the inverse right Jacobian times the angular
  // velocity v: v + arc x v / 2 + O(arc^2 v).
  const Eigen::Vector3d arc =
      so3_log(a.world_from_body.linear().transpose() * b.world_from_body.linear());
  const Hermite rotation(arc, at_a.angular_velocity,
                         at_b.angular_velocity + arc.cross(at_b.angular_velocity) / 2, h);
  const Eigen::Vector3d angle = rotation.value(motion.weight);
  motion.world_from_body.linear() = a.world_from_body.linear() * so3_exp(angle);
  motion.world_from_body.translation() =
      a.world_from_body.translation() + position.value(motion.weight);
  motion.velocity = motion.world_from_body.linear().transpose() * position.slope(motion.weight);
  motion.angular_velocity = so3_right_jacobian(angle) * rotation.slope(motion.weight);
  return motion;
}

LocalMotion RigModel::image_motion(int camera, int frame) const {
  return motion_at(initial_frames[frame].t_ns + std::llround(cameras[camera].offset_s * 1e9));
}

LocalMotion RigModel::pixel_motion(int camera, int frame, const Eigen::Vector2d& pixel) const {
  const RigModelCamera& c = cameras[camera];
  return motion_at(initial_frames[frame].t_ns +
                   std::llround((c.offset_s + c.from_middle_line(pixel) * c.readout_s) * 1e9));
}

Eigen::Vector3d RigModel::raised(const Eigen::Vector3d& in_body, std::size_t lidar) const {
  if (lidar_elevation_rad == 0 || lidar > 0) return in_body;
  return RaisedReturn(body_from_lidar, in_body).at(lidar_elevation_rad);
}

Rigid3d RigModel::corrected_pose(const LocalMotion& motion) const {
  const Vector6d &a = corrections[motion.segment], &b = corrections[motion.segment + 1];
  return motion.world_from_body * rigid_from_vector(a + motion.weight * (b - a));
}

Rigid3d RigModel::body_from_sensor(int camera) const {
  return cameras[camera].initial.body_from_sensor * rigid_from_vector(cameras[camera].extrinsics);
}

Rigid3d RigModel::world_from_camera(int camera, int frame, double later_s) const {
  const double after_s = cameras[camera].offset_s + later_s;
  return corrected_pose(motion_at(initial_frames[frame].t_ns + std::llround(after_s * 1e9))) *
         body_from_sensor(camera);
}

Camera RigModel::camera(int index) const {
  Camera camera = cameras[index].camera;
  const Eigen::Vector3d& change = cameras[index].intrinsics;
  camera.fx *= 1 + change.x();
  camera.fy *= 1 + change.x();
  camera.cx += change.y();
  camera.cy += change.z();
  return camera;
}

std::vector<FramePose> RigModel::corrected_frames() const {
  std::vector<FramePose> frames;
  for (std::size_t i = 0; i < initial_frames.size(); ++i)
    frames.push_back({initial_frames[i].id, initial_frames[i].t_ns,
                      global_from_world * initial_frames[i].world_from_body *
                          rigid_from_vector(corrections[i])});
  return frames;
}

CameraCalibration RigModel::corrected_calibration(int index) const {
  CameraCalibration calibration = cameras[index].initial;
  const Camera now = camera(index);
  std::ranges::copy(std::array{now.fx, now.fy, now.cx, now.cy}, calibration.parameters.begin());
  calibration.body_from_sensor = body_from_sensor(index);
  calibration.time_offset_ns = std::llround(cameras[index].offset_s * 1e9);
  calibration.readout_ns = std::llround(cameras[index].readout_s * 1e9);
  return calibration;
}

RigModel make_rig_model(const Recording& recording) {
  REDRIVE_CHECK_OP(recording.frames.size(), >=, 2u);
  RigModel model;
  model.global_from_world = recording.frames.front().global_from_body;
  const Rigid3d world_from_global = model.global_from_world.inverse(Eigen::Isometry);
  for (const FramePose& frame : recording.frames)
    model.initial_frames.push_back(
        {frame.id, frame.t_ns, world_from_global * frame.global_from_body});
  if (!recording.lidars.empty()) model.body_from_lidar = recording.lidars[0].body_from_lidar;
  model.corrections.assign(model.initial_frames.size(), Vector6d::Zero());
  for (const RecordedCamera& camera : recording.cameras) {
    RigModelCamera entry;
    entry.initial = camera.calibration;
    entry.camera = make_camera(camera.calibration);
    entry.offset_s = entry.initial_offset_s();
    entry.readout_s = entry.initial_readout_s();
    model.cameras.push_back(entry);
  }
  return model;
}

}  // namespace redrive
