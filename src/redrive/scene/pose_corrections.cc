// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/pose_corrections.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {
namespace {

/// The interval that contains a time among n ascending ones, and the fraction `part` in it, below 0
/// and above 1 at the ends as in recording/core/trajectory.h. With a single time, both ends are
/// that one.
struct Between {
  std::size_t before = 0;
  double part = 0;

  Between clamped() const { return {before, std::clamp(part, 0.0, 1.0)}; }
};
template <class TimeOf>
Between find_interval(std::size_t n, std::int64_t t_ns, const TimeOf& time_of) {
  if (n == 1) return {};
  std::size_t after = 1, end = n - 1;  // the first one later than t_ns, or the last one
  while (after < end) {
    const std::size_t middle = (after + end) / 2;
    if (time_of(middle) <= t_ns)
      after = middle + 1;
    else
      end = middle;
  }
  const std::int64_t a = time_of(after - 1), b = time_of(after);
  return {after - 1, static_cast<double>(t_ns - a) / static_cast<double>(b - a)};
}
/// Interpolates six numbers; with part = 0 reads only `a`.
std::array<float, 6> interpolate_vector6(const float* a, const float* b, double part) {
  std::array<float, 6> six;
  for (int k = 0; k < 6; ++k)
    six[k] = static_cast<float>(part == 0 ? a[k] : a[k] + part * (b[k] - a[k]));
  return six;
}

/// Velocity and angular velocity of the body in its own axes at a frame, from its neighbours.
struct BodyTwist {
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();
};
BodyTwist body_twist(const Scene& scene, int frame) {
  const int last = static_cast<int>(scene.frames.size()) - 1;
  const Frame &a = scene.frames[std::max(0, frame - 1)],
              &b = scene.frames[std::min(last, frame + 1)];
  if (a.t_ns == b.t_ns) return {};
  const double seconds = 1e-9 * static_cast<double>(b.t_ns - a.t_ns);
  const Rigid3d step = a.world_from_body.inverse() * b.world_from_body;
  const Eigen::AngleAxisd turn(step.linear());
  return {scene.frames[frame].world_from_body.linear().transpose() *
              (b.world_from_body.translation() - a.world_from_body.translation()) / seconds,
          turn.angle() / seconds * turn.axis()};
}

}  // namespace

Rigid3d rigid_from_vector(const float* six) {
  return rigid_from_vector(
      Vector6d(Eigen::Map<const Eigen::Matrix<float, 6, 1>>(six).cast<double>()));
}

void interpolate_held_out(const Scene& scene, PoseCorrections* corrections) {
  std::vector<bool> has_training_image(scene.frames.size());
  for (const View& view : scene.views)
    if (!view.held_out) has_training_image[view.frame] = true;
  std::vector<std::size_t> trained;
  for (std::size_t f = 0; f < scene.frames.size(); ++f)
    if (has_training_image[f]) trained.push_back(f);
  if (trained.empty()) return;
  for (std::size_t f = 0; f < scene.frames.size(); ++f) {
    if (has_training_image[f]) continue;
    const Between at = find_interval(trained.size(), scene.frames[f].t_ns, [&](std::size_t i) {
                         return scene.frames[trained[i]].t_ns;
                       }).clamped();
    const auto of = [&](std::size_t i) {
      return &corrections->values[corrections->frame_slot(static_cast<int>(trained[i]))];
    };
    const auto six = interpolate_vector6(of(at.before),
                                         of(std::min(at.before + 1, trained.size() - 1)), at.part);
    std::ranges::copy(six, &corrections->values[corrections->frame_slot(static_cast<int>(f))]);
  }
}

std::vector<FramePose> apply_corrections(const Scene& initial,
                                         const std::vector<FramePose>& trajectory,
                                         const PoseCorrections& corrections, Scene* corrected) {
  REDRIVE_CHECK_OP(corrections.values.size(), ==, corrections.size());
  REDRIVE_CHECK_OP(initial.frames.size(), ==, static_cast<std::size_t>(corrections.frames));
  REDRIVE_CHECK_OP(initial.rig.size(), ==, static_cast<std::size_t>(corrections.cameras));
  std::vector<FramePose> poses = trajectory;
  for (FramePose& pose : poses) {
    const Between at = find_interval(initial.frames.size(), pose.t_ns, [&](std::size_t i) {
                         return initial.frames[i].t_ns;
                       }).clamped();
    const float* const first =
        &corrections.values[corrections.frame_slot(static_cast<int>(at.before))];
    const auto six = interpolate_vector6(first, first + 6, at.part);
    pose.global_from_body = pose.global_from_body * rigid_from_vector(six.data());
  }
  for (std::size_t c = 0; c < initial.rig.size(); ++c) {
    const int camera = static_cast<int>(c);
    corrected->rig[c].body_from_sensor =
        initial.rig[c].body_from_sensor *
        rigid_from_vector(&corrections.values[corrections.camera_slot(camera)]);
    corrected->rig[c].time_offset_ns =
        initial.rig[c].time_offset_ns +
        std::llround(1e9 * corrections.values[corrections.time_slot(camera)]);
  }
  const Rigid3d world_from_global = initial.global_from_world.inverse();
  for (Frame& frame : corrected->frames)
    frame.world_from_body = world_from_global * pose_at(poses, frame.t_ns);
  for (View& view : corrected->views) update_view_pose(poses, *corrected, &view);
  return poses;
}

Vector6d in_body(const Scene& scene, const View& view, const ViewGradient& gradient) {
  const Eigen::Matrix3d body_from_world = view.world_from_body.linear().transpose();
  const Eigen::Vector3d by = body_from_world * gradient.d_translation,
                        lever = scene.rig[view.camera].body_from_sensor.translation();
  Vector6d six;
  six << by, body_from_world * gradient.d_rotation +
                 lever.cross(by);  // a rotation of the body also translates the camera
  return six;
}

std::vector<double> gradient_of_corrections(const Scene& scene, const PoseCorrections& corrections,
                                            std::span<const ViewGradient> views) {
  REDRIVE_CHECK_OP(views.size(), ==, scene.views.size());
  std::vector<double> out(corrections.size());
  const auto add = [&](std::size_t at, const Vector6d& six) {
    for (int k = 0; k < 6; ++k) out[at + k] += six[k];
  };
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (views[v].d_translation.isZero(0) && views[v].d_rotation.isZero(0)) continue;
    const View& view = scene.views[v];
    const RigCamera& camera = scene.rig[view.camera];
    const Eigen::Matrix3d camera_from_world = scene.world_from_camera(view).linear().transpose();
    Vector6d of_camera;
    of_camera << camera_from_world * views[v].d_translation,
        camera_from_world * views[v].d_rotation;
    add(corrections.camera_slot(view.camera), of_camera);
    const Vector6d of_body = in_body(scene, view, views[v]);
    const Between at =
        find_interval(scene.frames.size(), scene.frames[view.frame].t_ns + camera.time_offset_ns,
                      [&](std::size_t i) { return scene.frames[i].t_ns; });
    add(corrections.frame_slot(static_cast<int>(at.before)), (1 - at.part) * of_body);
    if (at.part != 0)
      add(corrections.frame_slot(static_cast<int>(at.before) + 1), at.part * of_body);
    const BodyTwist twist = body_twist(scene, view.frame);
    out[corrections.time_slot(view.camera)] +=
        twist.velocity.dot(of_body.head<3>()) + twist.turn.dot(of_body.tail<3>());
  }
  return out;
}

}  // namespace redrive
