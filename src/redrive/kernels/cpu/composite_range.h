// SPDX-License-Identifier: Apache-2.0
// Division of a batch by the cpu backend, and ranges of rays for the compositing kernels
// (cpu_kernels.h).
#pragma once

#include "redrive/kernels/backend.h"
#include "redrive/kernels/cpu/cpu_kernels.h"

namespace redrive::kernels {

/// Rays per entry of the thread pool's queue: some thousand samples, well above the cost
/// of an entry.
constexpr std::size_t kRaysPerRange = 64;

/// Chunks of a batch, each with its own gradient sums: enough to balance two to eight threads, few
/// enough to sum their gradients (2.4 MB each at width 256) quickly.
constexpr int kChunksPerBatch = 8;

/// Rays [first, first + n) of a batch.
struct RayRange {
  int first = 0, n = 0;
};

inline std::size_t first_sample(RayRange range, const Samples& samples) {
  return static_cast<std::size_t>(range.first) * samples.per_ray;
}

inline CompositeForward composite_rays(RayRange range, const Samples& samples, const float* raw,
                                       std::size_t raw_stride) {
  const std::size_t first = first_sample(range, samples);
  return {.n_rays = range.n,
          .per_ray = samples.per_ray,
          .raw = raw,
          .raw_stride = raw_stride,
          .t = samples.t.data() + first,
          .dt = samples.dt.data() + first};
}

inline CompositeResult composite_result(RayRange range, int n_rays, const Samples& samples,
                                        const CompositeOut& out) {
  return {
      .rgb = out.rgb.data() + range.first,
      .rgb_stride = static_cast<std::size_t>(n_rays),
      .depth = out.depth.data() + range.first,
      .opacity = out.opacity.data() + range.first,
      .weights = out.weights.empty() ? nullptr : out.weights.data() + first_sample(range, samples)};
}

}  // namespace redrive::kernels
