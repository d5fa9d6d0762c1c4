// SPDX-License-Identifier: Apache-2.0
// Matrix products of a few dozen columns: c[m, n] += sum_k a[m, k] b[k, n]. a is read number by number (any strides), b and c in
// whole vectors of a row; blocks of rows x columns of c stay in registers. Only for files with ISA flags (simd/vector.h).
#pragma once

#include "redrive/kernels/cpu/simd/vector.h"

namespace redrive::kernels::REDRIVE_ISA {

struct ProductInput {
  const float* data = nullptr;
  std::size_t row = 0, column = 0;  ///< strides in numbers
};

template <int kRows, int kVectors>
REDRIVE_INLINE void product_block(int depth, const ProductInput& a, const float* b, std::size_t b_row, float* c,
                                  std::size_t c_row) {
  Vf sum[kRows][kVectors];
#pragma GCC unroll 16
  for (int m = 0; m < kRows; ++m)
#pragma GCC unroll 4
    for (int v = 0; v < kVectors; ++v) sum[m][v] = load(c + m * c_row + v * kLanes);
  for (int k = 0; k < depth; ++k) {
    Vf right[kVectors];
#pragma GCC unroll 4
    for (int v = 0; v < kVectors; ++v) right[v] = load(b + k * b_row + v * kLanes);
#pragma GCC unroll 16
    for (int m = 0; m < kRows; ++m) {
      const Vf left = splat(a.data[m * a.row + k * a.column]);
#pragma GCC unroll 4
      for (int v = 0; v < kVectors; ++v) sum[m][v] += left * right[v];
    }
  }
#pragma GCC unroll 16
  for (int m = 0; m < kRows; ++m)
#pragma GCC unroll 4
    for (int v = 0; v < kVectors; ++v) store(c + m * c_row + v * kLanes, sum[m][v]);
}

/// Registers: 32 with AVX-512, 16 with AVX2.
constexpr int kProductRows = kLanes == 16 ? 12 : 6;

template <int kVectors>
static __attribute__((noinline)) void product_columns(int rows, int depth, ProductInput a, const float* b,
                                                      std::size_t b_row, float* c, std::size_t c_row) {
  int m = 0;
  for (; m + kProductRows <= rows; m += kProductRows) {
    product_block<kProductRows, kVectors>(depth, a, b, b_row, c + m * c_row, c_row);
    a.data += kProductRows * a.row;
  }
  for (; m + 4 <= rows; m += 4) {
    product_block<4, kVectors>(depth, a, b, b_row, c + m * c_row, c_row);
    a.data += 4 * a.row;
  }
  for (; m < rows; ++m) {
    product_block<1, kVectors>(depth, a, b, b_row, c + m * c_row, c_row);
    a.data += a.row;
  }
}

/// columns: a multiple of 16.
REDRIVE_INLINE void add_product(int rows, int columns, int depth, ProductInput a, const float* b, std::size_t b_row,
                                float* c, std::size_t c_row) {
  int n = 0;
  for (; n + 2 * kLanes <= columns; n += 2 * kLanes) product_columns<2>(rows, depth, a, b + n, b_row, c + n, c_row);
  for (; n < columns; n += kLanes) product_columns<1>(rows, depth, a, b + n, b_row, c + n, c_row);
}

}  // namespace redrive::kernels::REDRIVE_ISA
