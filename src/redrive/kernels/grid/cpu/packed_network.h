// SPDX-License-Identifier: Apache-2.0
// Weights of --method grid's MLPs in the kernels' layouts, packed once per pass over a batch.
#pragma once

#include <cstddef>

#include "redrive/base/buffer.h"
#include "redrive/kernels/grid/cpu/bf16_network.h"
#include "redrive/kernels/grid/grid_stages.h"

namespace redrive::kernels {

/// fp32: each matrix in both orders; refers to the network's weights.
class PackedNetwork {
 public:
  explicit PackedNetwork(const GridNetwork& network);
  const GridNetworkWeights& weights() const { return weights_; }

 private:
  /// Returns [columns, to_row] of a matrix [rows, from_row], the first `columns` numbers of each
  /// row.
  const float* pack(const float* from, int from_row, int rows, int columns, int to_row);

  Buffer<float> memory_;
  std::size_t used_ = 0;
  GridNetworkWeights weights_;
};

/// bf16: rounded, in blocks.
class PackedBf16Network {
 public:
  explicit PackedBf16Network(const GridNetwork& network);
  const GridBf16Weights& weights() const { return weights_; }

 private:
  /// A matrix [outputs, inputs], element (o, i) at from[o * output + i * input], 0 beyond; packed
  /// in blocks of `block` outputs.
  struct Matrix {
    const float* from = nullptr;
    int outputs = 0, inputs = 0, output = 0, input = 1;
  };
  const bf16::Bf16* pack(const Matrix& matrix, int block = kGridBf16Block);

  Buffer<bf16::Bf16> memory_;
  std::size_t used_ = 0;
  GridBf16Weights weights_;
};

}  // namespace redrive::kernels
