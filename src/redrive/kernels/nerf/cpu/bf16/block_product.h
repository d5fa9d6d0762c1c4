// SPDX-License-Identifier: Apache-2.0
// The block product by vdpbf16ps: acc[16 columns] += a[row][pair] . b[pair][16 columns].
// 8 rows x 2 vectors of columns = 16 accumulators: per pair of k 16 dot products, 2 loads of B and
// 8 broadcasts of A (Zen 5: two dot products and two loads a cycle, so 8 cycles against 5, and 8
// cycles between two uses of an accumulator against a latency of 6). Four such strips make the
// block; B stands in L1 after the first.
#pragma once

#include "redrive/kernels/cpu/simd/bf16_vector.h"
#include "redrive/kernels/nerf/cpu/bf16/plan.h"

namespace redrive::kernels::bf16 {
namespace {

/// C = sum of k0 block products a0[k] b0[k], then of k1 at a1, b1 (the concatenated encoding).
struct Product {
  const Bf16 *a0 = nullptr, *b0 = nullptr;
  int k0 = 0;
  const Bf16 *a1 = nullptr, *b1 = nullptr;
  int k1 = 0;
};

REDRIVE_INLINE void add_panel(const Bf16* a, const Bf16* b, int k_blocks, int strip,
                              __m512 (&acc)[8][2]) {
  using Pair [[gnu::may_alias]] = int;
  if (k_blocks == 0) return;  // a and b may be null
  const Bf16* a_strip = a + strip / 2 * kTileSize + strip % 2 * 8 * kBlock;
  for (int k = 0; k < k_blocks; ++k, a_strip += kBlockSize, b += kBlockSize) {
#pragma GCC unroll 4
    for (int pair = 0; pair < 16; ++pair) {
      const __m512bh b0 = (__m512bh)_mm512_load_si512(b + pair * kBlock);
      const __m512bh b1 = (__m512bh)_mm512_load_si512(b + kTileSize + pair * kBlock);
#pragma GCC unroll 8
      for (int r = 0; r < 8; ++r) {
        const auto a_pair = (__m512bh)_mm512_set1_epi32(
            *reinterpret_cast<const Pair*>(a_strip + r * kBlock + 2 * pair));
        acc[r][0] = _mm512_dpbf16_ps(acc[r][0], a_pair, b0);
        acc[r][1] = _mm512_dpbf16_ps(acc[r][1], a_pair, b1);
      }
    }
  }
}

REDRIVE_INLINE void store_strip(const __m512 (&acc)[8][2], float* c) {
#pragma GCC unroll 8
  for (int r = 0; r < 8; ++r) {
    _mm512_store_ps(c + r * 16, acc[r][0]);
    _mm512_store_ps(c + kTileFloats + r * 16, acc[r][1]);
  }
}

/// c = (bias ? its columns repeated : 0) + products. Prefetches the block `written`, unless null,
/// for writing.
REDRIVE_INLINE void write_product(const Product& p, const float* bias, float* c,
                                  const Bf16* written) {
  for (int strip = 0; strip < 4; ++strip) {
    constexpr int kOfLine = 64 / sizeof(Bf16), kOfStrip = kBlockSize / 4;
    for (int i = 0; written && i < kOfStrip; i += kOfLine)
      _mm_prefetch(written + strip * kOfStrip + i, _MM_HINT_ET0);
    const int i = strip / 2, r0 = strip % 2 * 8;
    __m512 acc[8][2];
#pragma GCC unroll 8
    for (int r = 0; r < 8; ++r) {
      acc[r][0] = acc[r][1] =
          bias ? _mm512_load_ps(bias + i * kTileFloats + (r0 + r) * 16) : _mm512_setzero_ps();
    }
    add_panel(p.a0, p.b0, p.k0, strip, acc);
    add_panel(p.a1, p.b1, p.k1, strip, acc);
    store_strip(acc, c + i * 2 * kTileFloats + r0 * 16);
  }
}

/// c = (clear ? 0 : c) + sum_k a_k b_k. Prefetches the C block that follows.
REDRIVE_INLINE void add_product(const Bf16* a, const Bf16* b, int k_blocks, bool clear, float* c) {
  for (int strip = 0; strip < 4; ++strip) {
    float* c_strip = c + strip / 2 * 2 * kTileFloats + strip % 2 * 8 * 16;
#pragma GCC unroll 8
    for (int r = 0; r < 8; ++r) {
      const float* next = c_strip + kBlockSize + r * 16;
      _mm_prefetch(next, _MM_HINT_T0);
      _mm_prefetch(next + kTileFloats, _MM_HINT_T0);
    }
    __m512 acc[8][2];
#pragma GCC unroll 8
    for (int r = 0; r < 8; ++r) {
      acc[r][0] = clear ? _mm512_setzero_ps() : _mm512_load_ps(c_strip + r * 16);
      acc[r][1] = clear ? _mm512_setzero_ps() : _mm512_load_ps(c_strip + kTileFloats + r * 16);
    }
    add_panel(a, b, k_blocks, strip, acc);
    store_strip(acc, c_strip);
  }
}

}  // namespace
}  // namespace redrive::kernels::bf16
