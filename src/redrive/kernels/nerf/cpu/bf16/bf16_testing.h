// SPDX-License-Identifier: Apache-2.0
// For the tests: conversions of bf16, and plain accessors of the block forms of simd/bf16_layout.h.
#pragma once

#include <bit>
#include <cstdint>

#include <gtest/gtest.h>

#include "redrive/base/cpu_features.h"
#include "redrive/kernels/nerf/cpu/bf16/plan.h"

namespace redrive::kernels::bf16 {

/// Skips a test where this processor cannot run the kernels.
#define SKIP_WITHOUT_BF16() \
  if (const auto obstacle = isa_obstacle(Isa::kAvx512Bf16)) GTEST_SKIP() << *obstacle

inline float from_bf16(Bf16 x) { return std::bit_cast<float>(std::uint32_t{x} << 16); }
/// Rounds a finite x to the nearest bf16, ties to even.
inline Bf16 to_bf16(float x) {
  const auto bits = std::bit_cast<std::uint32_t>(x);
  return static_cast<Bf16>((bits + 0x7fff + (bits >> 16 & 1)) >> 16);
}
inline float round_bf16(float x) { return from_bf16(to_bf16(x)); }

/// Offset of element (row, column) of a block.
inline int row_form(int row, int column) { return row / 16 * kTileSize + row % 16 * 32 + column; }
inline int pair_form(int row, int column) {
  return column / 16 * kTileSize + row / 2 * 32 + column % 16 * 2 + row % 2;
}
inline int c_form(int row, int column) {
  return row / 16 * 512 + column / 16 * 256 + row % 16 * 16 + column % 16;
}

}  // namespace redrive::kernels::bf16
