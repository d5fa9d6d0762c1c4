// SPDX-License-Identifier: Apache-2.0
// The size checks that every backend makes at the head of its stages (kernels.h says the shapes).
#pragma once

#include "redrive/base/error.h"
#include "redrive/base/host_device.h"
#include "redrive/kernels/backend.h"

namespace redrive::kernels {

inline std::size_t sample_count(int n_rays, const Samples& samples) {
  return static_cast<std::size_t>(n_rays) * static_cast<std::size_t>(samples.per_ray);
}

inline void check_gather(const PixelSpans& from, const PixelDraw& draw, std::size_t errors,
                         const GatheredRays& out) {
  REDRIVE_CHECK_OP(draw.epoch_rays, >=, 1);
  REDRIVE_CHECK_OP(draw.error_map_rays, >=, 0);
  REDRIVE_CHECK_OP(draw.begin + draw.epoch_rays, <=, from.pixels);
  const std::size_t n = static_cast<std::size_t>(draw.epoch_rays) + draw.error_map_rays;
  for (const std::span<float> xyz : {out.origin, out.direction, out.target})
    REDRIVE_CHECK_OP(xyz.size(), ==, 3 * n);
  for (const std::size_t size : {out.pixel_angle.size(), out.exposure.size(), out.view.size()})
    REDRIVE_CHECK_OP(size, ==, n);
  if (!out.background.empty()) REDRIVE_CHECK_OP(out.background.size(), ==, 3 * n);
  REDRIVE_CHECK(!from.random_background || !out.background.empty());
  REDRIVE_CHECK_OP(out.cell.size(), ==, draw.error_map_rays > 0 ? n : 0);
  REDRIVE_CHECK_OP(out.weight.size(), ==, out.cell.size());
  if (draw.error_map_rays > 0) REDRIVE_CHECK_OP(errors, ==, from.cell_pixels.size());
}

inline void check_gather_lidar(const LidarSpans& from, const GatheredReturns& out) {
  const std::size_t returns = from.range_m.size(), n = out.range_m.size();
  REDRIVE_CHECK_OP(returns, >, 0u);
  for (const std::size_t size : {from.origin.size(), from.direction.size()})
    REDRIVE_CHECK_OP(size, ==, 3 * returns);
  for (const std::size_t size : {out.origin.size(), out.direction.size()})
    REDRIVE_CHECK_OP(size, ==, 3 * n);
  REDRIVE_CHECK_OP(out.pixel_angle.size(), ==, n);
  REDRIVE_CHECK_OP(from.poses.size(), ==, from.recorded.size());
  if (!from.poses.empty()) REDRIVE_CHECK_OP(from.t_ns.size(), ==, returns);
}

inline void check_samples(int n_rays, const Samples& samples) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(samples.per_ray, >=, 1);
  REDRIVE_CHECK_OP(samples.t.size(), ==, sample_count(n_rays, samples));
  REDRIVE_CHECK_OP(samples.dt.size(), ==, sample_count(n_rays, samples));
}

inline void check_field(const NerfField& field, const Rays& rays, const Samples& samples) {
  check_samples(rays.n, samples);
  REDRIVE_CHECK_OP(rays.origin.size(), ==, 3 * static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(rays.direction.size(), ==, 3 * static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(field.parameters.size(), ==, nerf_parameter_count(field.config));
}

inline void check_raw(int n_rays, const Samples& samples, std::size_t raw_size) {
  REDRIVE_CHECK_OP(raw_size, ==, 4 * sample_count(n_rays, samples));
}

/// What rays get from compositing.
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
                                     const CompositeAdjoint& adjoint, std::size_t d_raw) {
  check_samples(n_rays, samples);
  check_raw(n_rays, samples, raw);
  check_raw(n_rays, samples, d_raw);
  check_background(n_rays, background);
  REDRIVE_CHECK_OP(adjoint.d_rgb.size(), ==, 3 * static_cast<std::size_t>(n_rays));
  if (!adjoint.d_weights.empty())
    REDRIVE_CHECK_OP(adjoint.d_weights.size(), ==, sample_count(n_rays, samples));
}

inline void check_stratified(int n_rays, const StratifiedSampling& how, std::size_t t_size,
                             std::size_t dt_size) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(how.per_ray, >=, 1);
  REDRIVE_CHECK_OP(how.near_m, <, how.far_m);
  REDRIVE_CHECK_OP(t_size, ==, static_cast<std::size_t>(n_rays) * how.per_ray);
  REDRIVE_CHECK_OP(dt_size, ==, t_size);
}

inline void check_ray_gradients(int n_rays, const RayGradients& of_rays) {
  REDRIVE_CHECK_OP(of_rays.d_direction.size(), ==, of_rays.d_origin.size());
  if (of_rays.wanted())
    REDRIVE_CHECK_OP(of_rays.d_origin.size(), ==, 3 * static_cast<std::size_t>(n_rays));
}

/// What one ray's samples in the unit cube, x_s = (origin + t_s direction - center) scale, make of
/// d_position (coordinate k of sample s at k * stride + s): d_origin += scale sum d_x_s,
/// d_direction += scale sum t_s d_x_s. Summed in double, in order.
template <class T>
REDRIVE_HD void add_ray_gradient(const UnitFromWorld& unit_from_world, int n_rays,
                                 const Samples& samples, int ray, const T* d_position,
                                 std::size_t stride, const RayGradients& of_rays) {
  const float* t = &samples.t[static_cast<std::size_t>(ray) * samples.per_ray];
  for (int k = 0; k < 3; ++k) {
    double d_origin = 0, d_direction = 0;
    for (int s = 0; s < samples.per_ray; ++s) {
      const double d = d_position[k * stride + s];
      d_origin += d;
      d_direction += t[s] * d;
    }
    const std::size_t at = k * static_cast<std::size_t>(n_rays) + ray;
    of_rays.d_origin[at] += static_cast<float>(unit_from_world.scale * d_origin);
    of_rays.d_direction[at] += static_cast<float>(unit_from_world.scale * d_direction);
  }
}

/// Returns the number of rays.
inline int check_hierarchical(const Samples& coarse, std::size_t weights_size, int extra,
                              std::size_t t_size, std::size_t dt_size) {
  REDRIVE_CHECK_OP(coarse.per_ray, >=, 3);
  REDRIVE_CHECK_OP(extra, >=, 1);
  const int n_rays = static_cast<int>(coarse.t.size() / coarse.per_ray);
  check_samples(n_rays, coarse);
  REDRIVE_CHECK_OP(weights_size, ==, coarse.t.size());
  REDRIVE_CHECK_OP(t_size, ==, static_cast<std::size_t>(n_rays) * (coarse.per_ray + extra));
  REDRIVE_CHECK_OP(dt_size, ==, t_size);
  return n_rays;
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
