// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/peak.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <numeric>
#include <vector>

#include "redrive/base/buffer.h"

namespace redrive::bench {
namespace {

using Loop = double (*)(long iterations);

Loop loop_of(std::optional<Isa> isa) {
  if (!isa) return sse2_multiply_add;
  switch (*isa) {
    case Isa::kAvx2: return avx2_multiply_add;
    case Isa::kAvx512: return avx512_multiply_add;
    case Isa::kAvx512Bf16: return avx512_bf16_multiply_add;
  }
  return sse2_multiply_add;
}

/// Returns the GFLOP/s of the calling thread: the best of many short runs, so that some have the
/// core for themselves.
double best_gflops(Loop loop) {
  constexpr double kTargetSeconds = 0.002;
  constexpr int kRuns = 60;
  long iterations = 10'000;
  double best = 0;
  for (int run = 0; run < kRuns;) {
    const auto start = std::chrono::steady_clock::now();
    const double flops = loop(iterations);
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (seconds < kTargetSeconds) {  // still calibrating the length
      iterations *= 2;
      continue;
    }
    best = std::max(best, flops / seconds * 1e-9);
    ++run;
  }
  return best;
}

}  // namespace

double measure_peak_gflops(std::optional<Isa> isa, ThreadPool& pool) {
  // All threads at the same time, because the clock frequency depends on the shared power budget.
  std::vector<double> gflops(pool.threads());
  pool.run(pool.threads(), [&](int chunk) { gflops[chunk] = best_gflops(loop_of(isa)); });
  return std::accumulate(gflops.begin(), gflops.end(), 0.0);
}

double measure_copy_gb_per_s(ThreadPool& pool) {
  constexpr std::size_t kOfThread = std::size_t{64} << 20, kLeast = std::size_t{256} << 20;
  constexpr int kRuns = 20;
  const std::size_t threads = pool.threads(), each = std::max(kOfThread, kLeast / threads);
  Buffer<char> from(threads * each), to(threads * each);
  double best = 0;
  for (int run = 0; run < kRuns; ++run) {
    const auto start = std::chrono::steady_clock::now();
    pool.run(pool.threads(),
             [&](int chunk) { std::memcpy(&to[chunk * each], &from[chunk * each], each); });
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    best = std::max(best, 2e-9 * static_cast<double>(from.size()) / seconds);
  }
  return best;
}

}  // namespace redrive::bench
