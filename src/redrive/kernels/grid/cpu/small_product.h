// SPDX-License-Identifier: Apache-2.0
// Matrix products with a few dozen columns: c[m, n] = start + sum_k a[m, k] b[k, n], with the
// layer's activation applied to the sums. a is read by scalars (any strides), b and c in whole
// vectors of a row; blocks of rows x columns of c stay in registers. Only for files with ISA flags
// (simd/vector.h).
#pragma once

#include "redrive/kernels/cpu/simd/vector.h"

namespace redrive::kernels::REDRIVE_ISA {

struct ProductInput {
  const float* data = nullptr;
  std::size_t row = 0, column = 0;  ///< strides in numbers
};

enum class Start { kZero, kSum, kRow };             ///< kSum: c as it is; kRow: Product::start
enum class Finish { kPlain, kRelu, kReluAdjoint };  ///< kReluAdjoint: 0 where gate <= 0

struct Product {
  int rows = 0, columns = 0, depth = 0;  ///< columns: a multiple of 16
  ProductInput a;
  const float* b = nullptr;
  std::size_t b_row = 0;
  float* c = nullptr;
  std::size_t c_row = 0;
  const float* start = nullptr;  ///< one row
  const float* gate = nullptr;   ///< activations, in rows like c
};

template <int kRows, int kVectors, Start kStart, Finish kFinish>
REDRIVE_INLINE void product_block(const Product& p, int row, int column) {
  float* const c = p.c + row * p.c_row + column;
  Vf sum[kRows][kVectors];
#pragma GCC unroll 16
  for (int m = 0; m < kRows; ++m)
#pragma GCC unroll 4
    for (int v = 0; v < kVectors; ++v)
      sum[m][v] = kStart == Start::kSum   ? load(c + m * p.c_row + v * kLanes)
                  : kStart == Start::kRow ? load(p.start + column + v * kLanes)
                                          : Vf{};
  const float* const a = p.a.data + row * p.a.row;
  const float* const b = p.b + column;
  const std::size_t a_row = p.a.row, a_column = p.a.column, b_row = p.b_row;
  for (int k = 0; k < p.depth; ++k) {
    Vf right[kVectors];
#pragma GCC unroll 4
    for (int v = 0; v < kVectors; ++v) right[v] = load(b + k * b_row + v * kLanes);
#pragma GCC unroll 16
    for (int m = 0; m < kRows; ++m) {
      const Vf left = splat(a[m * a_row + k * a_column]);
#pragma GCC unroll 4
      for (int v = 0; v < kVectors; ++v) sum[m][v] += left * right[v];
    }
  }
  const float* const gate =
      kFinish == Finish::kReluAdjoint ? p.gate + row * p.c_row + column : nullptr;
#pragma GCC unroll 16
  for (int m = 0; m < kRows; ++m)
#pragma GCC unroll 4
    for (int v = 0; v < kVectors; ++v) {
      Vf out = sum[m][v];
      if constexpr (kFinish == Finish::kRelu) out = out < Vf{} ? Vf{} : out;  // NaN stays NaN
      if constexpr (kFinish == Finish::kReluAdjoint)
        out = load(gate + m * p.c_row + v * kLanes) > Vf{} ? out : Vf{};
      store(c + m * p.c_row + v * kLanes, out);
    }
}

/// Registers: 32 with AVX-512, 16 with AVX2.
constexpr int kProductRows = kLanes == 16 ? 12 : 6;

template <int kVectors, Start kStart, Finish kFinish>
static __attribute__((noinline)) void product_columns(const Product& p, int column) {
  int m = 0;
  for (; m + kProductRows <= p.rows; m += kProductRows)
    product_block<kProductRows, kVectors, kStart, kFinish>(p, m, column);
  for (; m + 4 <= p.rows; m += 4) product_block<4, kVectors, kStart, kFinish>(p, m, column);
  switch (p.rows - m) {
    case 3: return product_block<3, kVectors, kStart, kFinish>(p, m, column);
    case 2: return product_block<2, kVectors, kStart, kFinish>(p, m, column);
    case 1: return product_block<1, kVectors, kStart, kFinish>(p, m, column);
  }
}

template <Start kStart, Finish kFinish>
REDRIVE_INLINE void product(const Product& p) {
  int n = 0;
  for (; n + 2 * kLanes <= p.columns; n += 2 * kLanes) product_columns<2, kStart, kFinish>(p, n);
  for (; n < p.columns; n += kLanes) product_columns<1, kStart, kFinish>(p, n);
}

}  // namespace redrive::kernels::REDRIVE_ISA
