// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/peak.h"

#include <immintrin.h>

namespace redrive::bench::avx2 {

double multiply_add(long iterations) {
  constexpr int kAccumulators = 12;
  __m256 sum[kAccumulators];
  for (__m256& s : sum) s = _mm256_setzero_ps();
  const __m256 half = _mm256_set1_ps(0.5f), one = _mm256_set1_ps(1);  // s -> s / 2 + 1 stays in [0, 2]
  for (long i = 0; i < iterations; ++i) {
    for (__m256& s : sum) {
      s = _mm256_fmadd_ps(s, half, one);
      __asm__ volatile("" : "+x"(s));  // neither hoisted nor merged
    }
  }
  return static_cast<double>(iterations) * kAccumulators * 8 * 2;
}

}  // namespace redrive::bench::avx2
