// SPDX-License-Identifier: Apache-2.0
// Layers of any width on tensor cores: a product of activations with packed weights
// (tensor_tiles.h) and the operations on its sums in registers.
//
// A warp computes 32 samples x 64 columns of sums. For each 16 of k it loads 1 KiB of activations
// and 2 KiB of weights, 24 cycles of the first-level cache, for 16 products: 32 cycles of an A100's
// tensor cores and 16 of an H100's, which the loads limit. With 256 columns, the four warps of a
// block share their samples. Tiles are read directly from memory, since they are stored in the
// layout of the registers; only other warps hide the latency.
#pragma once

#include "redrive/kernels/device/tensor_tiles.h"

namespace redrive::kernels {

/// y = x B (+ bias), [samples, columns], for activations x of tiles_of_k tiles of columns.
struct TensorProduct {
  static constexpr int kSampleTiles = 2, kColumnTiles = 4;

  std::size_t samples, columns, tiles_of_k;
  TensorActivations x;
  const LanePair* weights;      ///< [2 tensor_tiles(columns)][tiles_of_k]
  const float* bias = nullptr;  ///< [columns]
  bool has_relu = false;
  TensorActivations opened =
      {};                    ///< if it has rows: y becomes 0 where these outputs of a ReLU are 0
  TensorActivations y = {};  ///< written in the forms that are allocated
  SampleMatrix<float> numbers = {};  ///< y in fp32, if allocated
  bool adds = false;                 ///< to the present `numbers`

  std::size_t warps() const {
    return (tensor_tiles(samples) + kSampleTiles - 1) / kSampleTiles * groups_of(columns);
  }

  REDRIVE_HD void operator()(std::size_t warp) const {
    const std::size_t across = groups_of(columns), first_c = warp % across * kColumnTiles,
                      first_s = warp / across * kSampleTiles, column_tiles = tensor_tiles(columns),
                      last_s = tensor_tiles(samples) - 1;
    Sums16 sums[kSampleTiles][kColumnTiles];
    REDRIVE_UNROLL
    for (int c = 0; c < kColumnTiles; ++c) {
      REDRIVE_UNROLL
      for (int s = 0; s < kSampleTiles; ++s) sums[s][c] = begin(first_c + c);
    }
    for (std::size_t k = 0; k < tiles_of_k; ++k) {
      OperandA left[kSampleTiles];
      REDRIVE_UNROLL
      for (int s = 0; s < kSampleTiles; ++s)  // repeats the last sample beyond the end
        left[s] = load_a(x.row_tile(first_s + s < last_s ? first_s + s : last_s, k));
      REDRIVE_UNROLL
      for (int c = 0; c < kColumnTiles; ++c) {
        if (first_c + c >= column_tiles) continue;
        REDRIVE_UNROLL
        for (int half = 0; half < 2; ++half) {
          const OperandB right =
              load_b(weights + ((2 * (first_c + c) + half) * tiles_of_k + k) * kLanes);
          REDRIVE_UNROLL
          for (int s = 0; s < kSampleTiles; ++s)
            multiply_add(sums[s][c].half[half], left[s], right);
        }
      }
    }
    REDRIVE_UNROLL
    for (int s = 0; s < kSampleTiles; ++s) {
      REDRIVE_UNROLL
      for (int c = 0; c < kColumnTiles; ++c)
        if (first_s + s <= last_s && first_c + c < column_tiles)
          finish(first_s + s, first_c + c, sums[s][c]);
    }
  }

 private:
  REDRIVE_HD static std::size_t groups_of(std::size_t columns) {
    return (tensor_tiles(columns) + kColumnTiles - 1) / kColumnTiles;
  }
  REDRIVE_HD Sums16 begin(std::size_t c) const {
    Sums16 sums = zero_sums();
    if (!bias) return sums;
    REDRIVE_UNROLL
    for (int half = 0; half < 2; ++half)
      for (int here = 0; here < kLanesHere; ++here) {
        REDRIVE_UNROLL
        for (int i = 0; i < 4; ++i) {
          const std::size_t column =
              c * kTensorTile + 8 * half + position_in_sums(lane_of(here), i).column;
          if (column < columns) sums.half[half].lane[here][i] = bias[column];
        }
      }
    return sums;
  }
  REDRIVE_HD void finish(std::size_t s, std::size_t c, Sums16 sums) const {
    if (has_relu) rectify(sums);
    if (opened.rows) gate(sums, load_a(opened.row_tile(s, c)));
    y.put(s, c, operand_of(sums));
    if (!numbers.data) return;
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int half = 0; half < 2; ++half) {
        REDRIVE_UNROLL
        for (int i = 0; i < 4; ++i) {
          const MatrixPosition at = position_in_sums(lane_of(here), i);
          const std::size_t sample = s * kTensorTile + at.row,
                            column = c * kTensorTile + 8 * half + at.column;
          if (sample >= samples || column >= columns) continue;
          const float sum = sums.half[half].lane[here][i];
          numbers.at(sample, column) = adds ? numbers.at(sample, column) + sum : sum;
        }
      }
    }
  }
};

}  // namespace redrive::kernels
