// SPDX-License-Identifier: Apache-2.0
// For the tests: the engines by name, conversions of bf16, and plain accessors of the block forms
// of layout.h.
#pragma once

#include <bit>
#include <cstdint>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/cpu_features.h"
#include "redrive/kernels/cpu/bf16/plan.h"
#include "redrive/kernels/cpu/nerf_tile.h"

namespace redrive::kernels::bf16 {

enum class SumOrder {
  kPairs,  ///< VDPBF16PS: per pair of k a fused multiply-add of the odd member, then of the even
           ///< one
  kTiles   ///< TDPBF16PS: per 32 k separate sums of the even and the odd members, then their sum
           ///< added
};

struct EngineCase {
  const char* name;
  Isa isa;  ///< required of the processor
  SumOrder order;
  const Stages& (*stages)();
  std::unique_ptr<NerfNetwork> (*make)(const NerfConfig&);
};
inline void PrintTo(const EngineCase& engine, std::ostream* out) { *out << engine.name; }

inline std::vector<EngineCase> engine_cases() {
  return {{"avx512", Isa::kAvx512Bf16, SumOrder::kPairs, avx512_stages, make_nerf_avx512_bf16},
          {"amx_emulated", Isa::kAvx512Bf16, SumOrder::kTiles, amx_emulated_stages,
           make_nerf_amx_emulated},
          {"amx", Isa::kAmxBf16, SumOrder::kTiles, amx_stages, make_nerf_amx_bf16}};
}

/// Skips a test of an engine that this processor cannot run.
#define SKIP_WITHOUT(isa) \
  if (const auto obstacle = isa_obstacle(isa)) GTEST_SKIP() << *obstacle

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
