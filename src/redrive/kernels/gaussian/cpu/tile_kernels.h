// SPDX-License-Identifier: Apache-2.0
// Kernels of gaussian_kernels.h that have their own files, and the layout of a tile. Only for files
// with ISA flags.
#pragma once

#include "redrive/kernels/cpu/simd/vector.h"
#include "redrive/kernels/gaussian/cpu/gaussian_kernels.h"

namespace redrive::kernels::REDRIVE_ISA {

constexpr int kTilePixels = 16;  ///< a side
constexpr int kBlockRows = kLanes / kBlockColumns;
constexpr int kBlocksPerTile = kTilePixels * kTilePixels / kLanes;
constexpr float kLog2InverseMinAlpha = 7.9943534f;  ///< log2(255)

std::size_t bin(RasterRecord* records, const std::uint64_t* keys, std::size_t n,
                const TileGrid& grid, const std::uint8_t* wanted, TilePair* pairs);
void tile_forward(const TileForwardJob& job);
void tile_backward(const TileBackwardJob& job);
std::uint32_t tile_parts(const TilePartsJob& job);
void loss_row(const LossJob& job, int pass, int y, float* scratch, LossSums* sums);

}  // namespace redrive::kernels::REDRIVE_ISA
