// SPDX-License-Identifier: Apache-2.0
// Measures a device's roofline by functors: copies within its memory, and products in registers.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>

#include "redrive/kernels/backend.h"
#include "redrive/kernels/device/device_math.h"
#include "redrive/kernels/device/mma.h"
#include "redrive/kernels/device/ray_functors.h"
#include "redrive/kernels/device/stage.h"

namespace redrive::kernels {

struct CopyWords {
  std::span<const LaneWords> from;
  std::span<LaneWords> to;

  REDRIVE_HD void operator()(std::size_t i) const { to[i] = from[i]; }
};

/// A warp's products of 16 x 16 by 16 x 8. The latency of one is some thirty cycles, and each sum
/// waits for the one before, hence several independent sums.
struct BenchmarkMma {
  static constexpr int kRounds = 64, kSums = 8;
  static constexpr double kFlops = 2.0 * 16 * 16 * 8 * kSums * kRounds;

  float never;  ///< no sum equals this, which the compiler cannot know
  float* nowhere;

  REDRIVE_HD void operator()(std::size_t warp) const {
    OperandA a;
    OperandB b;
    Sums sums[kSums];
    for (int here = 0; here < kLanesHere; ++here) {
      // Numbers from 1 to 2, since zeros take less power.
      const std::uint32_t word =
          0x3F803F80u + (static_cast<std::uint32_t>(warp + 5 * lane_of(here)) & 0x3Fu) * 0x10001u;
      a.lane[here] = {{word, word + 1, word + 2, word + 3}};
      b.lane[here] = {{word, word + 1}};
      REDRIVE_UNROLL
      for (int c = 0; c < kSums; ++c) {
        REDRIVE_UNROLL
        for (int i = 0; i < 4; ++i) sums[c].lane[here][i] = 0;
      }
    }
    for (int round = 0; round < kRounds; ++round) {
      REDRIVE_UNROLL
      for (int c = 0; c < kSums; ++c) multiply_add(sums[c], a, b);
    }
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int c = 0; c < kSums; ++c) {
        REDRIVE_UNROLL
        for (int i = 0; i < 4; ++i)
          if (sums[c].lane[here][i] == never) *nowhere = never;
      }
    }
  }
};

/// A thread's fused multiply-adds in fp32, with a latency of four cycles.
struct BenchmarkFma {
  static constexpr int kRounds = 64, kSums = 8;
  static constexpr double kFlops = 2.0 * kSums * kRounds;

  float factor, term, never;
  float* nowhere;

  REDRIVE_HD void operator()(std::size_t i) const {
    float sums[kSums];
    REDRIVE_UNROLL
    for (int c = 0; c < kSums; ++c) sums[c] = static_cast<float>(i % 64 + c);
    for (int round = 0; round < kRounds; ++round) {
      REDRIVE_UNROLL
      for (int c = 0; c < kSums; ++c) sums[c] = multiply_add(sums[c], factor, term);
    }
    REDRIVE_UNROLL
    for (int c = 0; c < kSums; ++c)
      if (sums[c] == never) *nowhere = never;
  }
};

/// Returns how often `work` runs per second, at best. Batches of several calls take at least 2 ms,
/// so that the time to start a kernel is negligible.
template <class Device, class Work>
double best_rate_per_second(Device& device, const Work& work) {
  constexpr double kTargetSeconds = 0.002;
  constexpr int kRuns = 40;  // a GPU needs some to reach its full clock rate
  std::size_t times = 1;
  double best = 0;
  for (int run = 0; run < kRuns;) {
    const auto start = std::chrono::steady_clock::now();
    for (std::size_t i = 0; i < times; ++i) work();
    device.wait();
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (seconds < kTargetSeconds) {
      times *= 2;
      continue;
    }
    best = std::max(best, static_cast<double>(times) / seconds);
    ++run;
  }
  return best;
}

/// Measures tensor cores by mma, the instruction of the networks. An H100's wgmma, of four warps at
/// once, reaches more.
template <class Device>
Ceilings measure_ceilings(Device& device) {
  constexpr std::size_t kWarps = Device::kBenchmarkWarps, kThreads = kWarps * kLanes;
  constexpr float kNever = -1;  // all terms are positive
  Stage stage(device);
  const auto nowhere = stage.template scratch<float>(1);
  // 256 MiB on a GPU, more than any cache.
  const auto from = stage.template scratch<LaneWords>(4 * kThreads),
             to = stage.template scratch<LaneWords>(4 * kThreads);
  stage.for_each(
      from.size_bytes() / sizeof(float),
      Fill{{reinterpret_cast<float*>(from.data()), from.size_bytes() / sizeof(float)}, 1});
  Ceilings ceilings;
  const double copies = best_rate_per_second(device, [&] {
    stage.for_each(from.size(), CopyWords{from, to});
  });
  ceilings.copy_gb_per_s = 1e-9 * 2 * static_cast<double>(from.size_bytes()) * copies;
  if (device.has_tensor_cores()) {
    ceilings.arithmetic = "bf16 mma";
    const double rounds = best_rate_per_second(device, [&] {
      stage.for_each_warp(kWarps, BenchmarkMma{kNever, nowhere.data()});
    });
    ceilings.gflops = 1e-9 * kWarps * BenchmarkMma::kFlops * rounds;
  } else {
    ceilings.arithmetic = "fp32 fma";
    const double rounds = best_rate_per_second(device, [&] {
      stage.for_each(kThreads, BenchmarkFma{0.999f, 0.001f, kNever, nowhere.data()});
    });
    ceilings.gflops = 1e-9 * kThreads * BenchmarkFma::kFlops * rounds;
  }
  return ceilings;
}

}  // namespace redrive::kernels
