// SPDX-License-Identifier: Apache-2.0
// Size checks at the head of the stages of backend.h, the same for every backend.
#pragma once

#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"

namespace redrive::kernels {

inline std::size_t sample_count(int n_rays, const Samples& samples) {
  return static_cast<std::size_t>(n_rays) * static_cast<std::size_t>(samples.per_ray);
}

inline void check_samples(int n_rays, const Samples& samples) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(samples.per_ray, >=, 1);
  REDRIVE_CHECK_OP(samples.t.size(), ==, sample_count(n_rays, samples));
  REDRIVE_CHECK_OP(samples.dt.size(), ==, sample_count(n_rays, samples));
}

inline void check_raw(int n_rays, const Samples& samples, std::size_t raw_size) {
  REDRIVE_CHECK_OP(raw_size, ==, 4 * sample_count(n_rays, samples));
}

inline void check_composite(int n_rays, const Samples& samples, const CompositeOut& out) {
  REDRIVE_CHECK_OP(out.rgb.size(), ==, 3 * static_cast<std::size_t>(n_rays));
  REDRIVE_CHECK_OP(out.depth.size(), ==, static_cast<std::size_t>(n_rays));
  REDRIVE_CHECK_OP(out.opacity.size(), ==, static_cast<std::size_t>(n_rays));
  if (!out.weights.empty()) REDRIVE_CHECK_OP(out.weights.size(), ==, sample_count(n_rays, samples));
}

inline void check_background(int n_rays, std::span<const float> background) {
  if (!background.empty())
    REDRIVE_CHECK_OP(background.size(), ==, 3 * static_cast<std::size_t>(n_rays));
}

inline void check_composite_forward(int n_rays, const Samples& samples, std::size_t raw,
                                    std::span<const float> background, const CompositeOut& out) {
  check_samples(n_rays, samples);
  check_raw(n_rays, samples, raw);
  check_background(n_rays, background);
  check_composite(n_rays, samples, out);
}

inline void check_composite_backward(int n_rays, const Samples& samples, std::size_t raw,
                                     std::span<const float> background,
                                     const CompositeOutGradient& d_out, std::size_t d_raw) {
  check_samples(n_rays, samples);
  check_raw(n_rays, samples, raw);
  check_raw(n_rays, samples, d_raw);
  check_background(n_rays, background);
  REDRIVE_CHECK_OP(d_out.d_rgb.size(), ==, 3 * static_cast<std::size_t>(n_rays));
  if (!d_out.d_weights.empty())
    REDRIVE_CHECK_OP(d_out.d_weights.size(), ==, sample_count(n_rays, samples));
}

/// Returns the number of rays.
inline int check_photometric(std::size_t rgb_size, std::size_t target_size,
                             std::size_t d_rgb_size) {
  REDRIVE_CHECK_OP(rgb_size % 3, ==, 0u);
  REDRIVE_CHECK_OP(rgb_size, >, 0u);
  REDRIVE_CHECK_OP(target_size, ==, rgb_size);
  REDRIVE_CHECK_OP(d_rgb_size, ==, rgb_size);
  return static_cast<int>(rgb_size / 3);
}

inline void check_adam(std::size_t gradients, std::size_t parameters, std::size_t first_moment,
                       std::size_t second_moment) {
  REDRIVE_CHECK_OP(gradients, ==, parameters);
  REDRIVE_CHECK_OP(first_moment, ==, parameters);
  REDRIVE_CHECK_OP(second_moment, ==, parameters);
}

}  // namespace redrive::kernels
