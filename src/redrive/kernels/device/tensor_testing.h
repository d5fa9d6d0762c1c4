// SPDX-License-Identifier: Apache-2.0
// Activations in tiles from plain matrices and back, for tests.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "redrive/base/rng.h"
#include "redrive/kernels/device/tensor_tiles.h"

namespace redrive::kernels {

/// Returns integers in [-3, 3].
inline std::vector<float> small_numbers(std::size_t n, std::uint64_t stream) {
  std::vector<float> out(n);
  for (std::size_t i = 0; i < n; ++i)
    out[i] = static_cast<float>(
        static_cast<int>(random_bits(random_key(6, kStreamTest, stream), i) % 7) - 3);
  return out;
}

template <class Warps>
void run_warps(const Warps& functor) {
  for (std::size_t warp = 0; warp < functor.warps(); ++warp) functor(warp);
}

inline constexpr LaneWords kNanWords{{~0u, ~0u, ~0u, ~0u}};

struct TestActivations {
  std::vector<LaneWords> rows, columns;
  TensorActivations activations;

  TestActivations(std::size_t samples, std::size_t numbers)
      : rows(tensor_tiles(samples) * tensor_tiles(numbers) * kLanes, kNanWords),
        columns(rows),
        activations{rows.data(), columns.data(), tensor_tiles(samples), tensor_tiles(numbers)} {}

  /// Writes `count` numbers of each sample, [samples, count], to the tiles from first_to on.
  void put(const std::vector<float>& from, std::size_t samples, std::size_t count,
           std::size_t first_to = 0) {
    run_warps(PackTensorActivations{samples, count, {from.data(), count}, activations, first_to});
  }
  float at(std::size_t sample, std::size_t column) const {
    const OperandA a = load_a(activations.row_tile(sample / 16, column / 16));
    return number(a, sample % 16, column % 16);
  }
  float at_in_columns(std::size_t sample, std::size_t column) const {
    const OperandA a = load_a(activations.column_tile(sample / 16, column / 16));
    return number(a, column % 16, sample % 16);
  }
  static float number(const OperandA& a, int row, int column) {
    for (int lane = 0; lane < kLanes; ++lane)
      for (int w = 0; w < 4; ++w) {
        const MatrixPosition at = position_in_a(lane, w);
        if (at.row == row && at.column == column / 2 * 2)
          return column % 2 == 0 ? low_value(a.lane[lane].at[w]) : high_value(a.lane[lane].at[w]);
      }
    return NAN;
  }
};

}  // namespace redrive::kernels
