// SPDX-License-Identifier: Apache-2.0
// First step of the backward pass: packs fp32 gradients of a few outputs into one block of 32
// columns, zero beyond them.
#pragma once

#include <cstring>

#include "redrive/kernels/cpu/simd/bf16_vector.h"
#include "redrive/kernels/nerf/cpu/bf16/plan.h"

namespace redrive::kernels::bf16 {
namespace {

struct HeadGradient {
  const float* d = nullptr;  ///< output o of sample i at d[o * stride + i]
  std::ptrdiff_t stride = 0;
  int outputs = 0, samples = 0;  ///< outputs <= 4; samples past these get 0
  Bf16* next = nullptr;          ///< block of sample block n at next + n * next_stride blocks
  int next_stride = 0;
  Bf16* keep = nullptr;     ///< [n]
  float* d_bias = nullptr;  ///< [32], the sums are added
};

/// Writes D in row form (sample s: outputs in columns 0..3) to `next` and in pair form (samples 2
/// p, 2 p + 1) to `keep`.
inline void write_head_gradient(const HeadGradient& g) {
  constexpr int kMaxOutputs = 4;
  alignas(64) Bf16 rounded[kMaxOutputs][kBlock] = {};
  __m512 sum[kMaxOutputs];
  for (__m512& s : sum) s = _mm512_setzero_ps();
  for (int n = 0; n * kBlock < g.samples; ++n) {
    const __mmask16 valid0 = first_lanes(g.samples - n * kBlock),
                    valid1 = first_lanes(g.samples - n * kBlock - 16);
    for (int o = 0; o < g.outputs; ++o) {
      const float* d = g.d + o * g.stride + n * kBlock;
      const __m512 low = _mm512_maskz_loadu_ps(valid0, d),
                   high = _mm512_maskz_loadu_ps(valid1, d + 16);
      sum[o] = _mm512_add_ps(sum[o], _mm512_add_ps(low, high));
      store(rounded[o], to_bf16(low, high));
    }
    Bf16* next = g.next + std::ptrdiff_t(n) * g.next_stride * kBlockSize;
    for (int s = 0; s < kBlock; ++s) {
      std::uint64_t row = 0;
      for (int o = 0; o < kMaxOutputs; ++o) row |= std::uint64_t{rounded[o][s]} << (16 * o);
      store(next + s * kBlock,
            _mm512_zextsi128_si512(_mm_cvtsi64_si128(static_cast<long long>(row))));
    }
    Bf16* keep = g.keep + std::ptrdiff_t(n) * kBlockSize;
    for (int pair = 0; pair < 16; ++pair) {
      int both[kMaxOutputs];
      for (int o = 0; o < kMaxOutputs; ++o)
        std::memcpy(&both[o], &rounded[o][2 * pair], sizeof both[o]);
      store(keep + pair * kBlock,
            _mm512_zextsi128_si512(_mm_setr_epi32(both[0], both[1], both[2], both[3])));
      store(keep + kTileSize + pair * kBlock, _mm512_setzero_si512());
    }
  }
  for (int o = 0; o < g.outputs; ++o) g.d_bias[o] += _mm512_reduce_add_ps(sum[o]);
}

}  // namespace
}  // namespace redrive::kernels::bf16
