// SPDX-License-Identifier: Apache-2.0
// Changes the number of Gaussians during training: removes transparent ones and splits Gaussians in
// regions of large error. They stay ordered along a Morton curve, so that what a camera sees lies
// together in memory.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/base/parallel.h"
#include "redrive/model/gaussian_layout.h"

namespace redrive {

/// An actor's Gaussians may lie this far beside its box where they are at most kShadowHeight_m
/// above its lower bound: its shadow.
constexpr float kShadow_m = 1, kShadowHeight_m = 0.4f;
/// In the dark they may lie this far ahead of the box (x), where its headlights light the road.
constexpr float kHeadlights_m = 8;

struct DensifyOptions {
  std::size_t target = 0;     ///< number of Gaussians afterwards, at most
  float min_opacity = 0.01f;  ///< Gaussians below it are removed; 0: only unused ones
  /// share of the world's Gaussians with an error that is removed, the least errors first; less
  /// where few can be split in their place
  float replaced = 0;
  /// unused places at the end of the world's blocks, which count as Gaussians
  std::size_t spare = 0;
  /// least size of the largest axis, as a part of the distance: smaller Gaussians are not split
  float min_scale = 6e-4f;
  /// One per actor or part of one: half sides of the box around its origin in which its Gaussians
  /// stay, but for its shadow, metres; Gaussians outside are removed. Empty: no bounds.
  std::span<const Eigen::Vector3f> actor_bounds;
  /// distance ahead of the box in which Gaussians on the road stay, too
  float ahead_m = kShadow_m;
};

/// Splits Gaussians along their longest axis into two, drawn without replacement with probabilities
/// proportional to their summed errors. Removes transparent ones, and those with the least errors:
/// images hardly show them, or render them well. Sets the errors to 0. Parents keep their second
/// moments, children start without first moments. numbers: the Gaussians' and after them others,
/// which stay; moments, errors: the Gaussians' (kernels::GaussianUpdate). Deterministic in key,
/// whatever the number of threads. Gaussians stay in the world or with their actor.
void densify(const DensifyOptions& options, std::uint64_t key, GaussianLayout* layout,
             Buffer<float>* numbers, Buffer<std::uint32_t>* moments, Buffer<float>* errors,
             ThreadPool& pool);

}  // namespace redrive
