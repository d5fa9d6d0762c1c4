// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/poses/pose_refiner.h"

#include <algorithm>
#include <cmath>

#include "redrive/optim/adam.h"

namespace redrive {
namespace {

// An update has a few tens of rays per frame; Adam averages about twenty updates.
constexpr float kBeta1 = 0.95f, kBeta2 = 0.99f;

/// Subtracts from all cameras their mean correction in the body's axes, to first order:
/// translation, rotation and time offset.
void move_common_part_to_frames(const Scene& scene, PoseCorrections* corrections) {
  const int cameras = corrections->cameras;
  Eigen::Vector3d by = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();
  double time = 0;
  const auto part = [&](int c, int first) {
    return Eigen::Map<Eigen::Vector3f>(&corrections->values[corrections->camera_slot(c) + first]);
  };
  for (int c = 0; c < cameras; ++c) {
    const Eigen::Matrix3d body_from_camera = scene.rig[c].body_from_sensor.linear();
    turn += body_from_camera * part(c, 3).cast<double>() / cameras;
    by += body_from_camera * part(c, 0).cast<double>() / cameras;
    time += corrections->values[corrections->time_slot(c)] / cameras;
  }
  for (int c = 0; c < cameras; ++c) {
    const Eigen::Matrix3d camera_from_body = scene.rig[c].body_from_sensor.linear().transpose();
    part(c, 0) -= (camera_from_body * by).cast<float>();
    part(c, 3) -= (camera_from_body * turn).cast<float>();
    corrections->values[corrections->time_slot(c)] -= static_cast<float>(time);
  }
}

}  // namespace

float bound_of(const PoseBounds& bounds, const PoseCorrections& corrections, std::size_t i) {
  if (i >= corrections.time_slot(0)) return bounds.time_offset_s;
  return i % 6 < 3 ? bounds.translation_m : bounds.rotation_rad;
}

PoseRates pose_rates(double rate_m) { return {rate_m, rate_m / 10, rate_m / 10}; }

void update_poses(std::span<const double> gradient,
                  const std::function<double(std::size_t i)>& rate_of, std::span<float> values,
                  AdamMoments* moments) {
  const double updates = static_cast<double>(++moments->updates);
  AdamStep how;
  how.beta1 = kBeta1;
  how.beta2 = kBeta2;
  how.epsilon = 1e-20f;
  how.bias1 = static_cast<float>(1 / (1 - std::pow(double(kBeta1), updates)));
  how.bias2 = static_cast<float>(1 / (1 - std::pow(double(kBeta2), updates)));
  how.lazy = true;  // values without a gradient do not change
  for (std::size_t i = 0; i < values.size(); ++i) {
    how.learning_rate = static_cast<float>(rate_of(i));
    adam_update(how, static_cast<float>(gradient[i]), values[i], moments->first[i],
                moments->second[i]);
  }
}

void refine_poses(const Scene& scene, std::span<const ViewGradient> views, const PoseRates& rates,
                  const PoseRefinement& refinement, PoseState* state) {
  PoseCorrections& corrections = state->corrections;
  const std::vector<double> gradient = gradient_of_corrections(scene, corrections, views);
  if (!std::ranges::all_of(gradient, [](double g) { return std::isfinite(g); })) return;
  update_poses(
      gradient,
      [&](std::size_t i) {
        return i >= corrections.time_slot(0) ? rates.time_s
               : i % 6 < 3                   ? rates.translation_rate_m
                                             : rates.rotation_rate_rad;
      },
      corrections.values, &state->moments);
  move_common_part_to_frames(scene, &corrections);
  // Prior: small corrections are likelier than large ones.
  for (std::size_t i = 0; i < corrections.size(); ++i) {
    const float most = bound_of(refinement.bounds, corrections, i);
    corrections.values[i] = std::clamp(
        corrections.values[i] * static_cast<float>(1 - refinement.decay * rates.translation_rate_m),
        -most, most);
  }
  interpolate_held_out(scene, &corrections);
}

}  // namespace redrive
