// SPDX-License-Identifier: Apache-2.0
// AMX tile instructions as plain loops, to test the AMX layouts on processors without AMX.
// TDPBF16PS as Intel's manual describes it: per element two sums over k, of the even and of the odd
// members of the pairs, by fused multiply-adds that round to nearest even, take denormals as zero
// and flush them; then even + odd, then + C.
#pragma once

#include <cstring>

#include "redrive/kernels/cpu/bf16/vector.h"

namespace redrive::kernels::bf16 {
namespace {

struct TileState {
  alignas(64) char tile[8][1024];
  bool configured = false;
};
thread_local TileState t_tiles;

struct EmulatedTiles {
  static void configure() {
    std::memset(t_tiles.tile, 0, sizeof t_tiles.tile);
    t_tiles.configured = true;
  }
  static void release() { t_tiles.configured = false; }

  template <int tile>
  static void load(const void* p) {
    require_configured();
    std::memcpy(t_tiles.tile[tile], p, 1024);
  }
  template <int tile>
  static void store(void* p) {
    require_configured();
    std::memcpy(p, t_tiles.tile[tile], 1024);
  }
  template <int tile>
  static void zero() {
    require_configured();
    std::memset(t_tiles.tile[tile], 0, 1024);
  }
  template <int c, int a, int b>
  static void multiply() {
    require_configured();
    multiply(t_tiles.tile[c], t_tiles.tile[a], t_tiles.tile[b]);
  }

 private:
  /// The processor raises an invalid-opcode fault in this case.
  static void require_configured() {
    if (!t_tiles.configured) __builtin_trap();
  }

  static float widen(std::uint32_t bits) {
    if ((bits & 0x7f800000u) == 0) bits &= 0x80000000u;
    float value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
  }
  static float flush(float value) {
    std::uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return widen(bits);
  }

  __attribute__((noinline)) static void multiply(char* c, const char* a, const char* b) {
    for (int m = 0; m < 16; ++m) {
      float even[16] = {}, odd[16] = {}, row[16];
      for (int k = 0; k < 16; ++k) {
        std::uint32_t a_pair, b_pairs[16];
        std::memcpy(&a_pair, a + m * 64 + k * 4, sizeof a_pair);
        std::memcpy(b_pairs, b + k * 64, sizeof b_pairs);
        const float a_even = widen(a_pair << 16), a_odd = widen(a_pair & 0xffff0000u);
        for (int n = 0; n < 16; ++n) {
          even[n] = flush(__builtin_fmaf(a_even, widen(b_pairs[n] << 16), even[n]));
          odd[n] = flush(__builtin_fmaf(a_odd, widen(b_pairs[n] & 0xffff0000u), odd[n]));
        }
      }
      std::memcpy(row, c + m * 64, sizeof row);
      for (int n = 0; n < 16; ++n) row[n] = flush(row[n] + flush(even[n] + odd[n]));
      std::memcpy(c + m * 64, row, sizeof row);
    }
  }
};

}  // namespace
}  // namespace redrive::kernels::bf16
