// SPDX-License-Identifier: Apache-2.0
// AMX tile instructions as inline assembly. GCC 12's intrinsics are unsound: _tile_loadconfig names
// 8 of the 64 bytes it reads and _tile_loadd no memory at all, so stores may be moved behind them
// (SIGILL, stale data). Here every instruction names exactly the bytes it reads or writes. No -mamx
// flag is needed. volatile keeps the order among tile instructions.
#pragma once

#include "redrive/kernels/cpu/bf16/vector.h"

namespace redrive::kernels::bf16 {
namespace {

struct HardwareTiles {
  /// ldtilecfg's operand (Intel SDM, "Intel AMX"): palette 1, eight tiles of 16 rows x 64 bytes.
  struct alignas(64) Config {
    std::uint8_t palette = 1, start_row = 0, reserved[14] = {};
    std::uint16_t row_bytes[16] = {64, 64, 64, 64, 64, 64, 64, 64};
    std::uint8_t rows[16] = {16, 16, 16, 16, 16, 16, 16, 16};
  };
  static_assert(sizeof(Config) == 64);
  struct [[gnu::may_alias]] Tile {
    char bytes[1024];
  };

  static void configure() {
    const Config config;
    asm volatile("ldtilecfg %0" : : "m"(config));
  }
  static void release() { asm volatile("tilerelease"); }

  template <int tile>
  REDRIVE_INLINE static void load(const void* p) {
    asm volatile("tileloadd (%0,%1,1), %%tmm%c2"
                 :
                 : "r"(p), "r"(64L), "i"(tile), "m"(*static_cast<const Tile*>(p)));
  }
  template <int tile>
  REDRIVE_INLINE static void store(void* p) {
    asm volatile("tilestored %%tmm%c3, (%1,%2,1)"
                 : "=m"(*static_cast<Tile*>(p))
                 : "r"(p), "r"(64L), "i"(tile));
  }
  template <int tile>
  REDRIVE_INLINE static void zero() {
    asm volatile("tilezero %%tmm%c0" : : "i"(tile));
  }
  /// c += a b, pairs of bf16 (AT&T operand order: b, a, c).
  template <int c, int a, int b>
  REDRIVE_INLINE static void multiply() {
    asm volatile("tdpbf16ps %%tmm%c2, %%tmm%c1, %%tmm%c0" : : "i"(c), "i"(a), "i"(b));
  }
};

}  // namespace
}  // namespace redrive::kernels::bf16
