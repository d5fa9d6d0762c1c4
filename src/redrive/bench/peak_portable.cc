// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/peak.h"

#include <emmintrin.h>

namespace redrive::bench::portable {

double multiply_add(long iterations) {
  constexpr int kAccumulators = 8;
  __m128 sum[kAccumulators];
  for (__m128& s : sum) s = _mm_setzero_ps();
  const __m128 half = _mm_set1_ps(0.5f), one = _mm_set1_ps(1);  // s -> s / 2 + 1 stays in [0, 2]
  for (long i = 0; i < iterations; ++i) {
    for (__m128& s : sum) {
      s = _mm_add_ps(_mm_mul_ps(s, half), one);
      __asm__ volatile("" : "+x"(s));  // neither hoisted nor merged
    }
  }
  return static_cast<double>(iterations) * kAccumulators * 4 * 2;
}

}  // namespace redrive::bench::portable
