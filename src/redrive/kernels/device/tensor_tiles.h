// SPDX-License-Identifier: Apache-2.0
// Matrices in memory in the layout in which the warps of mma.h read them: tiles of 16 x 16, lane by
// lane, so that a warp loads a tile as 512 consecutive bytes without rearrangement. Activations are
// tiles of 16 samples, padded with zeros.
#pragma once

#include <span>

#include "redrive/kernels/device/fp32_layer_functors.h"
#include "redrive/kernels/device/mma.h"

namespace redrive::kernels {

constexpr int kTensorTile = 16;  ///< rows and columns of a tile

REDRIVE_HD constexpr std::size_t tensor_tiles(std::size_t n) {
  return (n + kTensorTile - 1) / kTensorTile;
}

REDRIVE_HD inline OperandA load_a(const LaneWords* tile) {
  OperandA a;
  for (int here = 0; here < kLanesHere; ++here) a.lane[here] = tile[lane_of(here)];
  return a;
}
REDRIVE_HD inline OperandB load_b(const LanePair* tile) {
  OperandB b;
  for (int here = 0; here < kLanesHere; ++here) b.lane[here] = tile[lane_of(here)];
  return b;
}
REDRIVE_HD inline void store(const OperandA& a, LaneWords* tile) {
  for (int here = 0; here < kLanesHere; ++here) tile[lane_of(here)] = a.lane[here];
}

/// Several functors of a type as one: the first runs for i in [0, n), the next for the following
/// indices.
template <class Functor, int kMost>
struct ConcatenatedFunctors {
  Functor each[kMost];
  std::size_t end[kMost];
  int count = 0;

  void add(const Functor& functor, std::size_t n) {
    end[count] = size() + n;
    each[count++] = functor;
  }
  std::size_t size() const { return count > 0 ? end[count - 1] : 0; }

  REDRIVE_HD void operator()(std::size_t i) const {
    int which = 0;
    while (i >= end[which]) ++which;
    each[which](i - (which > 0 ? end[which - 1] : 0));
  }
};

/// Numbers of samples [samples, columns] in two forms. `rows`: tile (s, c) is an OperandA of 16
/// samples x 16 columns, the left operand of a product with weights; a sample's tiles are
/// consecutive. `columns`: the transposed tile, whose product over samples is a weight's
/// derivative; a column's tiles are consecutive. Either may be null.
struct TensorActivations {
  LaneWords *rows = nullptr, *columns = nullptr;
  std::size_t sample_tiles = 0, column_tiles = 0;

  REDRIVE_HD LaneWords* row_tile(std::size_t s, std::size_t c) const {
    return rows + (s * column_tiles + c) * kLanes;
  }
  REDRIVE_HD LaneWords* column_tile(std::size_t s, std::size_t c) const {
    return columns + (c * sample_tiles + s) * kLanes;
  }
  REDRIVE_HD void put(std::size_t s, std::size_t c, const OperandA& a) const {
    if (rows) store(a, row_tile(s, c));
    if (columns) store(transposed(a), column_tile(s, c));
  }
};

/// Rounds numbers of samples to bf16 and writes them to tiles of columns from first_to on.
struct PackTensorActivations {
  std::size_t samples, columns;
  SampleMatrix<const float> from;
  TensorActivations to;
  std::size_t first_to;

  std::size_t warps() const { return tensor_tiles(samples) * tensor_tiles(columns); }

  REDRIVE_HD float number(std::size_t sample, std::size_t column) const {
    return sample < samples && column < columns ? from.at(sample, column) : 0.0f;
  }
  REDRIVE_HD void operator()(std::size_t warp) const {
    const std::size_t s = warp / tensor_tiles(columns), c = warp % tensor_tiles(columns);
    OperandA a;
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int w = 0; w < 4; ++w) {
        const MatrixPosition at = position_in_a(lane_of(here), w);
        const std::size_t sample = s * kTensorTile + at.row, column = c * kTensorTile + at.column;
        a.lane[here].at[w] = bf16_word(number(sample, column), number(sample, column + 1));
      }
    }
    to.put(s, first_to + c, a);
  }
};

/// A layer's weights as right operands: tile (n, k) of 8 columns x 16 rows of B, [tiles of n][tiles
/// of k]. Forward B = W^T (k: inputs, n: outputs), backward B = W (k: outputs, n: inputs). weight
/// [outputs, inputs] begins at the first input in use; its rows are `row` apart. The layer's tiles
/// of k begin at first_k, so that layers whose products are added up follow each other.
struct PackTensorWeights {
  const float* weight;
  std::size_t outputs, inputs, row;
  bool back;
  std::size_t first_k = 0, tiles_of_k = 0;
  LanePair* to = nullptr;

  REDRIVE_HD std::size_t own_tiles_of_k() const { return tensor_tiles(back ? outputs : inputs); }
  REDRIVE_HD std::size_t tiles_of_n() const { return 2 * tensor_tiles(back ? inputs : outputs); }
  std::size_t words() const { return own_tiles_of_k() * tiles_of_n() * kLanes * 2; }

  REDRIVE_HD float number(std::size_t k, std::size_t n) const {
    const std::size_t o = back ? k : n, i = back ? n : k;
    return o < outputs && i < inputs ? weight[o * row + i] : 0.0f;
  }
  REDRIVE_HD void operator()(std::size_t i) const {
    const int w = static_cast<int>(i % 2), lane = static_cast<int>(i / 2 % kLanes);
    const std::size_t tile = i / 2 / kLanes, k = tile % own_tiles_of_k(),
                      n = tile / own_tiles_of_k();
    const MatrixPosition at = position_in_b(lane, w);
    const std::size_t row_of_b = k * kTensorTile + at.row, column = n * 8 + at.column;
    to[(n * tiles_of_k + first_k + k) * kLanes + lane].at[w] =
        bf16_word(number(row_of_b, column), number(row_of_b + 1, column));
  }
};

/// Sums over a slice of the samples, 32 x 64 of them per warp, as LayerWeightBackward:
/// partial[slice * row] = d_y^T x [outputs, inputs], followed by the sums of d_y [outputs] if there
/// is a bias. For 16 samples a warp loads 3 KiB, 24 cycles of the first-level cache, for 16
/// products: 32 cycles of an A100's tensor cores and 16 of an H100's, which the loads limit.
struct TensorWeightBackward {
  static constexpr int kOutputTiles = 2, kInputTiles = 4;
  static constexpr std::size_t kTilesPerSlice = kSamplesPerSlice / kTensorTile;

  std::size_t samples, outputs, inputs;
  bool has_bias;
  TensorActivations d_y;
  std::size_t first_d_y;  ///< tile of columns of the layer's first output
  TensorActivations x;
  float* partial;
  std::size_t row;  ///< distance between the sums of two slices

  REDRIVE_HD std::size_t groups_of_inputs() const {
    return (tensor_tiles(inputs) + kInputTiles - 1) / kInputTiles;
  }
  REDRIVE_HD std::size_t groups_of_outputs() const {
    return (tensor_tiles(outputs) + kOutputTiles - 1) / kOutputTiles;
  }
  std::size_t warps() const {
    return slices_of(samples) * groups_of_outputs() * groups_of_inputs();
  }

  REDRIVE_HD void operator()(std::size_t warp) const {
    const std::size_t across = groups_of_inputs(), of_slice = across * groups_of_outputs(),
                      slice = warp / of_slice, first_o = warp % of_slice / across * kOutputTiles,
                      first_i = warp % across * kInputTiles, output_tiles = tensor_tiles(outputs),
                      input_tiles = tensor_tiles(inputs), all = tensor_tiles(samples),
                      begin = slice * kTilesPerSlice,
                      end = begin + kTilesPerSlice < all ? begin + kTilesPerSlice : all;
    const bool sums_bias = has_bias && first_i == 0;
    OperandB ones;
    for (auto& lane : ones.lane) lane = {{0x3F803F80u, 0x3F803F80u}};
    Sums16 sums[kOutputTiles][kInputTiles], of_bias[kOutputTiles];
    REDRIVE_UNROLL
    for (int o = 0; o < kOutputTiles; ++o) {
      of_bias[o] = zero_sums();
      REDRIVE_UNROLL
      for (int i = 0; i < kInputTiles; ++i) sums[o][i] = zero_sums();
    }
    for (std::size_t s = begin; s < end; ++s) {
      OperandA d[kOutputTiles];
      REDRIVE_UNROLL
      for (int o = 0; o < kOutputTiles; ++o)
        if (first_o + o < output_tiles) {
          d[o] = load_a(d_y.column_tile(s, first_d_y + first_o + o));
          if (sums_bias) multiply_add(of_bias[o].half[0], d[o], ones);
        }
      REDRIVE_UNROLL
      for (int i = 0; i < kInputTiles; ++i) {
        if (first_i + i >= input_tiles) continue;
        const OperandA inputs_there = load_a(x.column_tile(s, first_i + i));
        REDRIVE_UNROLL
        for (int half = 0; half < 2; ++half) {
          const OperandB right = right_operand(inputs_there, half);
          REDRIVE_UNROLL
          for (int o = 0; o < kOutputTiles; ++o)
            if (first_o + o < output_tiles) multiply_add(sums[o][i].half[half], d[o], right);
        }
      }
    }
    float* const out = partial + slice * row;
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int o = 0; o < kOutputTiles; ++o) {
        REDRIVE_UNROLL
        for (int n = 0; n < 4; ++n) {
          const MatrixPosition at = position_in_sums(lane_of(here), n);
          const std::size_t output = (first_o + o) * kTensorTile + at.row;
          if (output >= outputs) continue;
          REDRIVE_UNROLL
          for (int i = 0; i < 2 * kInputTiles; ++i) {
            const std::size_t input = first_i * kTensorTile + 8 * i + at.column;
            if (input < inputs)
              out[output * inputs + input] = sums[o][i / 2].half[i % 2].lane[here][n];
          }
          if (sums_bias && at.column == 0)
            out[outputs * inputs + output] = of_bias[o].half[0].lane[here][n];
        }
      }
    }
  }
};

}  // namespace redrive::kernels
