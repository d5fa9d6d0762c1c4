// SPDX-License-Identifier: Apache-2.0
// The block product by vdpbf16ps: acc[16 columns] += a[row][pair] . b[pair][16 columns].
// 8 rows x 2 vectors of columns = 16 accumulators: per pair of k 16 dot products, 2 loads of B and
// 8 broadcasts of A (Zen 5: two dot products and two loads a cycle, so 8 cycles against 5, and 8
// cycles between two uses of an accumulator against a latency of 6). Four such strips make the
// block; B stands in L1 after the first.
#pragma once

#include "redrive/kernels/cpu/bf16/product.h"

namespace redrive::kernels::bf16 {
namespace {

struct Avx512Engine {
  /// 192 samples x 256 neurons x 8.5 layers of kept activations are 0.8 MiB, within Zen 5's L2 of 1
  /// MiB; 2 x 96 or 4 x 48, whole blocks. Forward and backward of 98,304 samples at width 256 on
  /// one thread: 625 to 631 ms from 192 to 960.
  static constexpr int kTileSamples = 192;

  static void begin() {}
  static void end() {}

  /// c = (bias ? its columns repeated : 0) + products. Runs the pending epilogue (which reads c)
  /// first.
  template <class PendingBlock>
  REDRIVE_INLINE static void product(const Product& p, const float* bias, float* c,
                                     PendingBlock& pending, Prefetch& prefetch) {
    if (pending.exists()) pending.rows(0, kBlock);
    for (int strip = 0; strip < 4; ++strip) {
      prefetch.prepare_write(strip * 8, 8);
      const int i = strip / 2, r0 = strip % 2 * 8;
      __m512 acc[8][2];
#pragma GCC unroll 8
      for (int r = 0; r < 8; ++r) {
        acc[r][0] = acc[r][1] =
            bias ? _mm512_load_ps(bias + i * kTileFloats + (r0 + r) * 16) : _mm512_setzero_ps();
      }
      panel(p.a0, p.b0, p.k0, strip, acc);
      panel(p.a1, p.b1, p.k1, strip, acc);
      store_strip(acc, c + i * 2 * kTileFloats + r0 * 16);
    }
  }

  REDRIVE_INLINE static void accumulate(const Bf16* a, const Bf16* b, int k_blocks, bool clear,
                                        float* c, const PanelPrefetch& prefetch) {
    for (int strip = 0; strip < 4; ++strip) {
      const int offset = strip / 2 * 2 * kTileFloats + strip % 2 * 8 * 16;
      float* c_strip = c + offset;
#pragma GCC unroll 8
      for (int r = 0; r < 8; ++r) {  // the same rows of the next block
        const char* next = prefetch.next_c + (offset + r * 16) * sizeof(float);
        _mm_prefetch(next, _MM_HINT_T0);
        _mm_prefetch(next + kTileFloats * sizeof(float), _MM_HINT_T0);
      }
      __m512 acc[8][2];
#pragma GCC unroll 8
      for (int r = 0; r < 8; ++r) {
        acc[r][0] = clear ? _mm512_setzero_ps() : _mm512_load_ps(c_strip + r * 16);
        acc[r][1] = clear ? _mm512_setzero_ps() : _mm512_load_ps(c_strip + kTileFloats + r * 16);
      }
      panel(a, b, k_blocks, strip, acc);
      store_strip(acc, c_strip);
    }
  }

 private:
  REDRIVE_INLINE static void panel(const Bf16* a, const Bf16* b, int k_blocks, int strip,
                                   __m512 (&acc)[8][2]) {
    using Pair [[gnu::may_alias]] = int;
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

  REDRIVE_INLINE static void store_strip(const __m512 (&acc)[8][2], float* c) {
#pragma GCC unroll 8
    for (int r = 0; r < 8; ++r) {
      _mm512_store_ps(c + r * 16, acc[r][0]);
      _mm512_store_ps(c + kTileFloats + r * 16, acc[r][1]);
    }
  }
};

}  // namespace
}  // namespace redrive::kernels::bf16
