// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/peak.h"

#include <immintrin.h>

namespace redrive::bench::avx512_bf16 {

double multiply_add(long iterations) {
  constexpr int kAccumulators = 24;
  __m512 sum[kAccumulators];
  for (__m512& s : sum) s = _mm512_setzero_ps();
  const __m512bh ones = (__m512bh)_mm512_set1_epi32(0x3F803F80);                      // (1, 1)
  const __m512bh signs = (__m512bh)_mm512_set1_epi32(static_cast<int>(0xBF803F80u));  // (1, -1): s + 1 - 1
  for (long i = 0; i < iterations; ++i) {
    for (__m512& s : sum) {
      s = _mm512_dpbf16_ps(s, ones, signs);
      __asm__ volatile("" : "+v"(s));  // neither hoisted nor merged
    }
  }
  return static_cast<double>(iterations) * kAccumulators * 32 * 2;
}

}  // namespace redrive::bench::avx512_bf16
