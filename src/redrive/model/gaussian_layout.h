// SPDX-License-Identifier: Apache-2.0
// Gaussians in a list, and in blocks that are ordered along a Morton curve, so that what a camera
// sees lies together in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/field/gaussian.h"

namespace redrive {

/// Gaussians one after the other: [n][kGaussianRows].
struct GaussianList {
  std::vector<float> rows;
  std::size_t size() const { return rows.size() / kGaussianRows; }
};

/// Layout: the world's blocks first, then each actor's. An articulated actor counts as its parts.
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

/// Returns the index of the first Gaussian of a part: 0: the world, from 1 on actors.
std::size_t first_of(const GaussianLayout& layout, std::size_t part);

/// Returns the layout of these numbers of Gaussians, the world's first. An actor has at least one
/// block.
GaussianLayout layout_of(std::span<const std::size_t> sizes);
GaussianLayout layout_of(std::span<const GaussianList> lists);

/// Returns the place of a position [3] on a Morton curve through space contracted by its logarithm.
std::uint32_t morton_key(const float* position);

/// Writes Gaussians in Morton order into blocks; unused lanes are transparent.
void write_blocks(std::span<const GaussianList> lists, const GaussianLayout& layout,
                  Buffer<float>* numbers);

}  // namespace redrive
