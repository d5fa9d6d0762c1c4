// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/peak.h"

#include <algorithm>
#include <chrono>
#include <vector>

namespace redrive::bench {
namespace {

using Loop = double (*)(long iterations);

Loop loop_of(std::optional<Isa> isa) {
  if (!isa) return portable::multiply_add;
  switch (*isa) {
    case Isa::kAvx2: return avx2::multiply_add;
    case Isa::kAvx512: return avx512::multiply_add;
    case Isa::kAvx512Bf16: return avx512_bf16::multiply_add;
    case Isa::kAmxBf16: return amx_bf16::multiply_add;
  }
  return portable::multiply_add;
}

}  // namespace

double measure_peak_gflops(std::optional<Isa> isa, ThreadPool& pool) {
  constexpr double kTargetSeconds = 0.02;
  constexpr int kRuns = 8;
  const Loop loop = loop_of(isa);
  std::vector<double> flops(pool.threads());
  long iterations = 10'000;
  double best = 0;
  for (int run = 0; run < kRuns;) {
    const auto start = std::chrono::steady_clock::now();
    pool.run(pool.threads(), [&](int lane) { flops[lane] = loop(iterations); });
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (seconds < kTargetSeconds) {  // still finding the length
      iterations *= 2;
      continue;
    }
    double sum = 0;
    for (const double f : flops) sum += f;
    best = std::max(best, sum / seconds * 1e-9);
    ++run;
  }
  return best;
}

}  // namespace redrive::bench
