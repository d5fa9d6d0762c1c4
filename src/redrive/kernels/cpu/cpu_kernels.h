// SPDX-License-Identifier: Apache-2.0
// The stages around the networks as a table of functions over ranges, compiled once per vector
// width. The backend cuts the work and owns the memory. Formulas: volume/composite.h, optim/adam.h
// and volume/hierarchical_sampling.h.
#pragma once

#include <cstddef>
#include <cstdint>

namespace redrive::kernels {

/// Rays with their samples: channel k of sample i = ray * per_ray + s is raw[k * raw_stride + i].
struct CompositeForward {
  int n_rays = 0, per_ray = 0;
  const float* raw = nullptr;
  std::size_t raw_stride = 0;
  const float *t = nullptr, *dt = nullptr;
  const float* background =
      nullptr;  ///< channel k of a ray: background[k * background_stride + ray]; may be null
  std::size_t background_stride = 0;
};

/// Channel k of a ray's colour is rgb[k * rgb_stride + ray]; weights may be null.
struct CompositeResult {
  float* rgb = nullptr;
  std::size_t rgb_stride = 0;
  float *depth = nullptr, *opacity = nullptr, *weights = nullptr;
};

/// Channel k of a ray: d_rgb[k * d_rgb_stride + ray]; of a sample: d_raw[k * d_raw_stride + i];
/// d_weights as weights, may be null.
struct CompositeGradient {
  const float* d_rgb = nullptr;
  std::size_t d_rgb_stride = 0;
  float* d_raw = nullptr;
  std::size_t d_raw_stride = 0;
  const float* d_weights = nullptr;
};

/// Floats of scratch memory of the composite stages: three rows of whole vectors.
static constexpr std::size_t composite_scratch(int per_ray) {
  return 3 * (static_cast<std::size_t>(per_ray) + 16);
}

/// Constants of AdamStep (optim/adam.h), and arrays [n].
struct AdamRange {
  float learning_rate, beta1, beta2, epsilon, bias1, bias2;
  bool lazy;
  float *gradients, *parameters, *first_moment, *second_moment;
  std::size_t n;
};

struct CpuKernels {
  void (*composite_forward)(const CompositeForward& rays, const CompositeResult& out,
                            float* scratch);
  void (*composite_backward)(const CompositeForward& rays, const CompositeGradient& adjoint,
                             float* scratch);
  void (*adam)(const AdamRange& range);
};

namespace avx2 {
extern const CpuKernels kCpuKernels;
}
namespace avx512 {
extern const CpuKernels kCpuKernels;
}

}  // namespace redrive::kernels
