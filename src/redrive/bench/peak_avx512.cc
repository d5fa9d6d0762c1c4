// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/peak.h"

#include <immintrin.h>

namespace redrive::bench::avx512 {

double multiply_add(long iterations) {
  constexpr int kAccumulators = 16;
  __m512 sum[kAccumulators];
  for (__m512& s : sum) s = _mm512_setzero_ps();
  const __m512 half = _mm512_set1_ps(0.5f), one = _mm512_set1_ps(1);  // s -> s / 2 + 1 stays in [0, 2]
  for (long i = 0; i < iterations; ++i) {
    for (__m512& s : sum) {
      s = _mm512_fmadd_ps(s, half, one);
      __asm__ volatile("" : "+v"(s));  // neither hoisted nor merged
    }
  }
  return static_cast<double>(iterations) * kAccumulators * 16 * 2;
}

}  // namespace redrive::bench::avx512
