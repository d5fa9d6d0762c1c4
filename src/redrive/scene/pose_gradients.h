// SPDX-License-Identifier: Apache-2.0
// Derivatives of a loss with respect to pose corrections, from its derivatives with respect to the
// poses of views.
#pragma once

#include <span>
#include <vector>

#include "redrive/scene/scene.h"

namespace redrive {

/// Interpolates the corrections of frames without a training image by time between the frames
/// before and after that have one; beyond the ends the nearest one's.
void interpolate_held_out(const Scene& scene, PoseCorrections* corrections);

/// Gradient of the loss with respect to one view's pose, in the world: translating its camera by v
/// and rotating it by w (rad) raises the loss by d_translation v + d_rotation w.
struct ViewGradient {
  Eigen::Vector3d d_translation = Eigen::Vector3d::Zero(), d_rotation = Eigen::Vector3d::Zero();
};
/// Returns the gradient with respect to the six numbers (rigid_from_vector) of the body that
/// carries the camera.
Vector6d in_body(const Scene& scene, const View& view, const ViewGradient& gradient);
/// Converts the scene's gradients of views to gradients of corrections, at 0 or at the corrections
/// of `scene`. A view between two frames (with a time offset) depends on both.
std::vector<double> gradient_of_corrections(const Scene& scene, const PoseCorrections& corrections,
                                            std::span<const ViewGradient> views);

}  // namespace redrive
