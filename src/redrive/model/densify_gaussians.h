// SPDX-License-Identifier: Apache-2.0
// Changes the number of Gaussians during training: transparent ones are removed, and those in
// regions of large error are split. The Gaussians stay ordered along a Morton curve, so that what a
// camera sees lies together in memory.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/model/initial_gaussians.h"

namespace redrive {

/// An actor's Gaussians may lie so far beside its box where they are at most kShadowHeight_m above
/// the lower bound: its shadow.
constexpr float kShadow_m = 1, kShadowHeight_m = 0.4f;
/// Likewise so far ahead of the box (x) in the dark: what headlights light.
constexpr float kHeadlights_m = 8;

struct DensifyOptions {
  std::size_t target = 0;     ///< number of Gaussians afterwards, at most
  float min_opacity = 0.01f;  ///< less is removed; 0: unused ones alone
  std::size_t spare = 0;      ///< unused places at the end of the world's, which count as Gaussians
  /// least size of the largest axis, as a part of the distance: smaller Gaussians are not split
  float min_scale = 6e-4f;
  /// One per actor: half sides of the box around its origin in which its Gaussians stay, but for
  /// its shadow, metres; Gaussians outside are removed. Empty: no bounds.
  std::span<const Eigen::Vector3f> actor_bounds;
  float ahead_m = kShadow_m;  ///< ahead of the box on the road, where they stay, too
};

/// Where the Gaussians of the world and of each actor are: in blocks of their own.
struct GaussianLayout {
  std::size_t world = 0;  ///< number of Gaussians of the world, from the first block
  /// one per actor: the end of its blocks, which follow the world's
  std::vector<std::int64_t> actor_ends;

  std::size_t world_blocks() const { return gaussian_blocks(world); }
  std::size_t first_block(std::size_t actor) const {
    return actor == 0 ? world_blocks() : static_cast<std::size_t>(actor_ends[actor - 1]);
  }
  std::size_t blocks() const { return first_block(actor_ends.size()); }
};

/// Returns the layout of lists of Gaussians, of the world first. An actor has at least one block.
GaussianLayout layout_of(std::span<const GaussianList> lists);

/// Writes Gaussians in Morton order into blocks; unused lanes are transparent.
void write_blocks(std::span<const GaussianList> lists, const GaussianLayout& layout,
                  Buffer<float>* numbers);

/// Splits Gaussians along their longest axis into two, drawn without replacement with probabilities
/// proportional to their summed error (the row kDistanceRow of the moments), and removes
/// transparent ones. Sets the summed errors to 0. Parents keep their second moments, children start
/// without first moments. numbers: the Gaussians' and after them others, which stay; moments: the
/// Gaussians' (GaussianUpdate::moments). Deterministic in key. Gaussians stay in the world or with
/// their actor.
void densify(const DensifyOptions& options, std::uint64_t key, GaussianLayout* layout,
             Buffer<float>* numbers, Buffer<std::uint32_t>* moments);

}  // namespace redrive
