// SPDX-License-Identifier: Apache-2.0
// Where the tiles of a raster with PixelCentres lie.
#pragma once

#include <span>

#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

/// A tile's blocks of pixels, numbered row by row.
struct BlockShape {
  int columns, rows;

  int across() const { return kTileSide / columns; }
  int blocks() const { return across() * (kTileSide / rows); }
};

/// Writes boxes [tiles, 4, blocks]: least and greatest u, then v of each block; and extents: least
/// and greatest u of each column of tiles, then v of each row, made to ascend without narrowing any
/// [2 columns + 2 rows].
void find_boxes(const RasterSize& size, const PixelCentres& centres, const BlockShape& shape,
                ThreadPool& pool, float* boxes, std::span<float> extents);

}  // namespace redrive::kernels
