// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/centre_boxes.h"

#include <algorithm>
#include <limits>

namespace redrive::kernels {
namespace {

constexpr std::size_t kBoxedTilesPerRange = 4;

void make_ascending(float* low, float* high, int tiles) {
  for (int t = 1; t < tiles; ++t) {
    high[t] = std::max(high[t], high[t - 1]);
    low[tiles - 1 - t] = std::min(low[tiles - 1 - t], low[tiles - t]);
  }
}

/// Writes the least and greatest number of a block of a plane, whose first pixel is at `first`.
void find_box(std::span<const float> plane, std::size_t first, int stride, const BlockShape& shape,
              float* least, float* greatest) {
  *least = *greatest = plane[first];
  for (int row = 0; row < shape.rows; ++row)
    for (int column = 0; column < shape.columns; ++column) {
      const float at = plane[first + static_cast<std::size_t>(row) * stride + column];
      *least = std::min(*least, at);
      *greatest = std::max(*greatest, at);
    }
}

}  // namespace

void find_boxes(const RasterSize& size, const PixelCentres& centres, const BlockShape& shape,
                ThreadPool& pool, float* boxes, std::span<float> extents) {
  const int tiles_x = size.stride / kTileSide, tiles_y = size.rows / kTileSide,
            blocks = shape.blocks();
  const std::size_t tiles = static_cast<std::size_t>(tiles_x) * tiles_y;
  pool.run_ranges(tiles, kBoxedTilesPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t tile = begin; tile < end; ++tile)
      for (int b = 0; b < blocks; ++b) {
        const std::size_t x = tile % tiles_x * kTileSide + b % shape.across() * shape.columns,
                          y = tile / tiles_x * kTileSide + b / shape.across() * shape.rows,
                          first = y * size.stride + x;
        float* const box = boxes + tile * 4 * blocks + b;
        find_box(centres.u, first, size.stride, shape, box, box + blocks);
        find_box(centres.v, first, size.stride, shape, box + 2 * blocks, box + 3 * blocks);
      }
  });
  constexpr float kFar = std::numeric_limits<float>::max();
  float *const low_u = extents.data(), *const high_u = low_u + tiles_x,
               *const low_v = high_u + tiles_x, *const high_v = low_v + tiles_y;
  std::fill(low_u, high_u, kFar);
  std::fill(high_u, low_v, -kFar);
  std::fill(low_v, high_v, kFar);
  std::fill_n(high_v, tiles_y, -kFar);
  for (std::size_t tile = 0; tile < tiles; ++tile) {
    const float* const box = boxes + tile * 4 * blocks;
    const std::size_t x = tile % tiles_x, y = tile / tiles_x;
    low_u[x] = std::min(low_u[x], std::ranges::min(std::span(box, blocks)));
    high_u[x] = std::max(high_u[x], std::ranges::max(std::span(box + blocks, blocks)));
    low_v[y] = std::min(low_v[y], std::ranges::min(std::span(box + 2 * blocks, blocks)));
    high_v[y] = std::max(high_v[y], std::ranges::max(std::span(box + 3 * blocks, blocks)));
  }
  make_ascending(low_u, high_u, tiles_x);
  make_ascending(low_v, high_v, tiles_y);
}

}  // namespace redrive::kernels
