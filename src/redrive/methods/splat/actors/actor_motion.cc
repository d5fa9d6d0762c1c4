// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/actors/actor_motion.h"

#include <algorithm>
#include <vector>

namespace redrive {
namespace {

constexpr float kSmoothing = 0.02f, kDecay = 0.002f;  // factors of an update
constexpr double kAtKey = 0.25;  // part of the way between keys: nearer images move one key

/// Returns the later key's share in the derivative with respect to a motion.
float share_of_later(const KeyTime& at) {
  if (at.part < kAtKey) return 0;
  return at.part > 1 - kAtKey ? 1 : static_cast<float>(at.part);
}

}  // namespace

bool add_motion_gradient(const GaussianPoseGradient<NumberMath<double>>& d_pose,
                         const Eigen::Vector3d& camera, std::span<const float> motions,
                         const KeyTime& at, std::span<float> d_motions) {
  // The camera moves relative to the object: by -exp(-w) u and -w x camera, and turns by -w.
  const Eigen::Vector3d d_translation(d_pose.translation), d_rotation(d_pose.rotation);
  const auto motion = interpolate_vector6(&motions[kMotionSize * at.before],
                                          &motions[kMotionSize * at.after], at.part);
  const Eigen::Matrix3d turned = rigid_from_vector(motion.data()).linear();
  const Eigen::Vector3d d_u = -turned * d_translation,
                        d_w = -camera.cross(d_translation) - d_rotation;
  if (!d_u.cast<float>().allFinite() || !d_w.cast<float>().allFinite()) return false;
  const float later = share_of_later(at);
  for (int k = 0; k < 3; ++k)
    for (const auto& [key, part] : {std::pair(at.before, 1 - later), std::pair(at.after, later)}) {
      d_motions[kMotionSize * key + k] += part * static_cast<float>(d_u[k]);
      d_motions[kMotionSize * key + 3 + k] += part * static_cast<float>(d_w[k]);
    }
  return true;
}

void update_motions(AdamStep step, float rate, std::span<const float> gradients,
                    std::span<float> motions, std::span<float> first_moment,
                    std::span<float> second_moment) {
  const std::size_t keys = motions.size() / kMotionSize;
  const auto any = [](std::span<const float> of, std::size_t key) {
    return std::ranges::any_of(of.subspan(kMotionSize * key, kMotionSize),
                               [](float x) { return x != 0; });
  };
  const std::vector<float> before(motions.begin(), motions.end());
  for (std::size_t key = 0; key < keys; ++key) {
    const bool has_gradient = any(gradients, key);
    if (!has_gradient && any(second_moment, key)) continue;
    for (std::size_t k = 0; k < kMotionSize; ++k) {
      const std::size_t i = kMotionSize * key + k;
      const float own = before[i], left = key > 0 ? before[i - kMotionSize] : own,
                  right = key + 1 < keys ? before[i + kMotionSize] : own;
      if (!has_gradient) {
        motions[i] = (left + right) / 2;
        continue;
      }
      step.learning_rate = k < 3 ? rate : 0.1f * rate;
      adam_update(step, gradients[i], motions[i], first_moment[i], second_moment[i]);
      const float most = k < 3 ? kMaxMotion_m : kMaxMotion_rad;
      motions[i] = std::clamp((1 - kDecay) * (motions[i] + kSmoothing * (left + right - 2 * own)),
                              -most, most);
    }
  }
}

}  // namespace redrive
