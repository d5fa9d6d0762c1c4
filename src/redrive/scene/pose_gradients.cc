// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/pose_gradients.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"

namespace redrive {
namespace {

/// Velocity and angular velocity of the body in its own axes at a frame, from its neighbours.
struct BodyTwist {
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();
};
BodyTwist body_twist(const Scene& scene, int frame) {
  const int last = static_cast<int>(scene.frames.size()) - 1;
  const std::int64_t a_ns = scene.frames[std::max(0, frame - 1)].t_ns,
                     b_ns = scene.frames[std::min(last, frame + 1)].t_ns;
  if (a_ns == b_ns) return {};
  const double seconds = 1e-9 * static_cast<double>(b_ns - a_ns);
  const Rigid3d a = scene.world_from_body(a_ns), b = scene.world_from_body(b_ns);
  const Eigen::AngleAxisd turn((a.inverse() * b).linear());
  return {scene.world_from_body(scene.frames[frame].t_ns).linear().transpose() *
              (b.translation() - a.translation()) / seconds,
          turn.angle() / seconds * turn.axis()};
}

}  // namespace

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

Vector6d in_body(const Scene& scene, const View& view, const ViewGradient& gradient) {
  const Eigen::Matrix3d body_from_world = scene.world_from_body(view).linear().transpose();
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
