// SPDX-License-Identifier: Apache-2.0
// Corrections of the tracks of moving objects, which train along with their Gaussians: for each key
// of a track a translation u (metres) and a rotation w (rad), as MovingObject::corrections has
// them. world_from_actor becomes world_from_actor exp(w) with the origin moved by u.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "redrive/field/gaussian.h"
#include "redrive/optim/adam.h"
#include "redrive/scene/moving_object.h"

namespace redrive {

constexpr std::size_t kMotionSize = 6;  ///< u, then w

/// Largest absolute correction of a coordinate.
constexpr float kMaxMotion_m = 0.5f, kMaxMotion_rad = 0.1f;

/// Adds the derivative with respect to the motions; for w to first order, which is 0.1 rad at most.
/// At less than a quarter of the way from a key it goes to that key alone: Adam moves a key by its
/// full rate whatever the share of its gradient, so the box of a held-out image, some milliseconds
/// off a training image, would not stay between its neighbours. d_pose: derivative with respect to
/// a camera's pose in the corrected object's axes (GaussianPoseGradient); camera: its position
/// there. Returns false, and adds nothing, where the derivative is not finite.
bool add_motion_gradient(const GaussianPoseGradient<NumberMath<double>>& d_pose,
                         const Eigen::Vector3d& camera, std::span<const float> motions,
                         const KeyTime& at, std::span<float> d_motions);

/// A step of Adam on a track's corrections: keys that have a gradient move by it, and all are
/// smoothed towards the neighbouring keys and towards 0, within the bounds. Keys that never had
/// one, because their images are held out, lie between their neighbours. All spans: [keys,
/// kMotionSize]. rate: for translations, metres; a tenth of it, in rad, for rotations.
void update_motions(AdamStep step, float rate, std::span<const float> gradients,
                    std::span<float> motions, std::span<float> first_moment,
                    std::span<float> second_moment);

}  // namespace redrive
