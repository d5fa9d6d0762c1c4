// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/rig/rig_model.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

Rigid3d rigid_of(const Vector6d& v) {
  Rigid3d motion = Rigid3d::Identity();
  motion.linear() = so3_exp(v.tail<3>());
  motion.translation() = v.head<3>();
  return motion;
}

/// How poses move at one of them.
struct Slope {
  Eigen::Vector3d velocity, turn;  ///< m/s in the world; rad/s in the body
};

Slope between_frames(const std::vector<FramePose>& frames, int a) {
  const double h = static_cast<double>(frames[a + 1].t_ns - frames[a].t_ns) * 1e-9;
  return {
      (frames[a + 1].global_from_body.translation() - frames[a].global_from_body.translation()) / h,
      so3_log(frames[a].global_from_body.linear().transpose() *
              frames[a + 1].global_from_body.linear()) /
          h};
}

/// Of the parabola through the frame and its neighbours, at an end through the three there; of two
/// frames the line.
Slope slope_at(const std::vector<FramePose>& frames, int frame) {
  const int last = static_cast<int>(frames.size()) - 1;
  if (last == 1) return between_frames(frames, 0);
  const int middle = std::clamp(frame, 1, last - 1);
  const Slope before = between_frames(frames, middle - 1), after = between_frames(frames, middle);
  const double h_before = static_cast<double>(frames[middle].t_ns - frames[middle - 1].t_ns),
               h_after = static_cast<double>(frames[middle + 1].t_ns - frames[middle].t_ns),
               all = h_before + h_after;
  // The slope changes evenly from the middle of the first interval to that of the second one.
  const double at = frame < middle   ? -h_before / all
                    : frame > middle ? 1 + h_after / all
                                     : h_before / all;
  return {before.velocity + at * (after.velocity - before.velocity),
          before.turn + at * (after.turn - before.turn)};
}

/// The cubic from 0 with slope `from` to `end` with slope `to` in h seconds; u in 0..1.
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

Instant RigModel::at(std::int64_t t_ns) const {
  Instant instant = smooth_at(t_ns);
  // What the corrections of now add, linear in time, is taken out again: what is left is a motion
  // to which changed corrections can be added.
  const int a = instant.segment;
  const Vector6d slope = (correction[a + 1] - correction[a]) / instant.duration_s,
                 added = correction[a] + instant.weight * instant.duration_s * slope;
  const Rigid3d now = rigid_of(added);
  const Eigen::Vector3d rho = added.head<3>(), turn = now.linear() * instant.turn,
                        own_turn =
                            now.linear() * so3_right_jacobian(added.tail<3>()) * slope.tail<3>();
  instant.velocity = now.linear() * instant.velocity + rho.cross(turn - own_turn) - slope.head<3>();
  instant.turn = turn - own_turn;
  instant.world_from_body = instant.world_from_body * now.inverse(Eigen::Isometry);
  return instant;
}

Instant RigModel::smooth_at(std::int64_t t_ns) const {
  const auto after =
      std::upper_bound(given.begin(), given.end(), t_ns,
                       [](std::int64_t t, const FramePose& f) { return t < f.t_ns; });
  Instant instant;
  instant.segment = static_cast<int>(std::clamp<std::ptrdiff_t>(
      after - given.begin() - 1, 0, static_cast<std::ptrdiff_t>(given.size()) - 2));
  // The frames that the slopes at both ends need.
  const int first = std::max(0, instant.segment - 1),
            end =
                std::min(static_cast<int>(given.size()), std::max(instant.segment + 3, first + 3));
  const int start = std::max(0, std::min(first, end - 3));
  std::vector<FramePose> frames(given.begin() + start, given.begin() + end);
  for (int f = start; f < end; ++f)
    frames[f - start].global_from_body = given[f].global_from_body * rigid_of(correction[f]);
  const int here = instant.segment - start;
  const FramePose &a = frames[here], &b = frames[here + 1];
  const double h = static_cast<double>(b.t_ns - a.t_ns) * 1e-9;
  instant.duration_s = h;
  instant.weight = static_cast<double>(t_ns - a.t_ns) * 1e-9 / h;
  const Slope at_a = slope_at(frames, here), at_b = slope_at(frames, here + 1);
  if (instant.weight < 0 || instant.weight > 1) {
    const bool before = instant.weight < 0;
    const double beyond_s = (before ? instant.weight : instant.weight - 1) * h;
    const Slope& slope = before ? at_a : at_b;
    const Eigen::Matrix3d turned = so3_exp(slope.turn * beyond_s);
    instant.world_from_body = (before ? a : b).global_from_body;
    instant.velocity =
        turned.transpose() * instant.world_from_body.linear().transpose() * slope.velocity;
    instant.world_from_body.translation() += slope.velocity * beyond_s;
    instant.world_from_body.linear() = instant.world_from_body.linear() * turned;
    instant.turn = slope.turn;
    return instant;
  }
  const Hermite position(b.global_from_body.translation() - a.global_from_body.translation(),
                         at_a.velocity, at_b.velocity, h);
  // Rotation vectors from a's: at b their rate is the inverse right Jacobian times the turn, v +
  // arc x v / 2 + O(arc^2 v).
  const Eigen::Vector3d arc =
      so3_log(a.global_from_body.linear().transpose() * b.global_from_body.linear());
  const Hermite rotation(arc, at_a.turn, at_b.turn + arc.cross(at_b.turn) / 2, h);
  const Eigen::Vector3d turned = rotation.value(instant.weight);
  instant.world_from_body.linear() = a.global_from_body.linear() * so3_exp(turned);
  instant.world_from_body.translation() =
      a.global_from_body.translation() + position.value(instant.weight);
  instant.velocity = instant.world_from_body.linear().transpose() * position.slope(instant.weight);
  instant.turn = so3_right_jacobian(turned) * rotation.slope(instant.weight);
  return instant;
}

Instant RigModel::of_image(int camera, int frame) const {
  return at(given[frame].t_ns + std::llround(cameras[camera].offset_s * 1e9));
}

Instant RigModel::of_row(int camera, int frame, double v) const {
  const RigModelCamera& c = cameras[camera];
  return at(given[frame].t_ns +
            std::llround((c.offset_s + c.from_middle_row(v) * c.readout_s) * 1e9));
}

Rigid3d RigModel::corrected(const Instant& instant) const {
  const Vector6d &a = correction[instant.segment], &b = correction[instant.segment + 1];
  return instant.world_from_body * rigid_of(a + instant.weight * (b - a));
}

Rigid3d RigModel::body_from_sensor(int camera) const {
  return cameras[camera].given.body_from_sensor * rigid_of(cameras[camera].mount);
}

Rigid3d RigModel::world_from_camera(int camera, int frame, double later_s) const {
  const double after_s = cameras[camera].offset_s + later_s;
  return corrected(at(given[frame].t_ns + std::llround(after_s * 1e9))) * body_from_sensor(camera);
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
  std::vector<FramePose> frames = given;
  for (std::size_t i = 0; i < frames.size(); ++i)
    frames[i].global_from_body =
        global_from_world * given[i].global_from_body * rigid_of(correction[i]);
  return frames;
}

CameraCalibration RigModel::corrected_calibration(int index) const {
  CameraCalibration calibration = cameras[index].given;
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
  model.given = recording.frames;
  for (FramePose& frame : model.given)
    frame.global_from_body =
        model.global_from_world.inverse(Eigen::Isometry) * frame.global_from_body;
  model.correction.assign(model.given.size(), Vector6d::Zero());
  for (const RecordedCamera& camera : recording.cameras) {
    RigModelCamera entry;
    entry.given = camera.calibration;
    entry.camera = make_camera(camera.calibration);
    entry.offset_s = entry.initial_offset_s();
    entry.readout_s = entry.initial_readout_s();
    model.cameras.push_back(entry);
  }
  return model;
}

}  // namespace redrive
