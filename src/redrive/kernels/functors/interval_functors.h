// SPDX-License-Identifier: Apache-2.0
// Stages of grid_stages.h on the intervals of rays as functors for one ray or one sample, in float
// unless noted. The host runs them in loops (host_stage.h), a device in kernels (device/stage.h).
// Their spans are in the memory where they run.
#pragma once

#include <cmath>

#include "redrive/base/rng.h"
#include "redrive/kernels/grid_stages.h"
#include "redrive/volume/median_distance.h"
#include "redrive/volume/ray_intervals.h"
#include "redrive/volume/ray_weights.h"

namespace redrive::kernels {

/// Whether the field is evaluated on a ray (GridStages::compact_rays).
struct IsActiveRay {
  RayCompaction how;
  int per_ray;
  std::span<const float> weights;

  REDRIVE_HD bool operator()(std::size_t ray) const {
    float opacity = 0;
    for (int i = 0; i < per_ray; ++i) opacity += weights[ray * per_ray + i];
    // Negated, so that a ray whose weights are NaN is active and its loss shows it.
    return !(opacity < how.min_opacity) || random_unit(how.key, ray) < how.keep_probability;
  }
};

/// Writes the list for a batch without active rays: ray 0, since stages take at least one.
struct SetToRayZero {
  std::span<std::uint32_t> rays;

  REDRIVE_HD void operator()(std::size_t) const { rays[0] = 0; }
};

struct SampleUniform {
  Rays rays;
  UniformSampling how;
  std::span<float> edges;

  REDRIVE_HD void operator()(std::size_t ray) const {
    float origin[3], direction[3];
    for (int k = 0; k < 3; ++k) {
      origin[k] = rays.origin[k * rays.n + ray];
      direction[k] = rays.direction[k * rays.n + ray];
    }
    uniform_edges(clip_to_scene(how.spacing, how.contraction, origin, direction), how.per_ray,
                  how.jitter, how.key, ray, &edges[ray * (how.per_ray + 1)]);
  }
};

struct SamplePdf {
  Intervals from;
  std::span<const float> weights;
  PdfSampling how;
  std::span<float> edges;

  REDRIVE_HD void operator()(std::size_t ray) const {
    pdf_edges(&from.edges[ray * (from.per_ray + 1)], &weights[ray * from.per_ray], from.per_ray,
              how.per_ray, how.padding, how.jitter, how.key, ray, &edges[ray * (how.per_ray + 1)]);
  }
};

struct IntervalMidpoints {
  Intervals intervals;
  std::span<float> t, dt;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray;
    const float* const edges = &intervals.edges[first + ray];
    for (int s = 0; s < intervals.per_ray; ++s) {
      t[first + s] = 0.5f * (edges[s] + edges[s + 1]);
      dt[first + s] = edges[s + 1] - edges[s];
    }
  }
};

/// Computes one sample in double.
struct ContractSamples {
  Contraction contraction;
  Rays rays;
  std::span<const float> pixel_angle;
  Intervals intervals;
  float least_width;
  std::span<float> position, footprint;

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::size_t n_rays = rays.n, n = n_rays * intervals.per_ray, ray = i / intervals.per_ray,
                      edge = i + ray;
    const double begin = intervals.edges[edge], end = intervals.edges[edge + 1],
                 t = 0.5 * (begin + end);
    double world[3], unit[3];
    for (int k = 0; k < 3; ++k)
      world[k] = rays.origin[k * n_rays + ray] + t * rays.direction[k * n_rays + ray];
    const double factor = contract(contraction, world, unit), side = pixel_angle[ray] * t;
    for (int k = 0; k < 3; ++k) position[k * n + i] = static_cast<float>(unit[k]);
    const double volume = side * side * (end - begin), least = least_width * (end - begin);
    footprint[i] = static_cast<float>(factor * std::fmax(std::cbrt(volume), least));
  }
};

/// Computes one ray with sums in T.
template <class T>
struct ContractBackward {
  Contraction contraction;
  Rays rays;
  Intervals intervals;
  std::span<const float> d_position;
  std::span<float> d_origin, d_direction;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t n_rays = rays.n, n = n_rays * intervals.per_ray;
    T origin[3]{}, direction[3]{};
    for (int s = 0; s < intervals.per_ray; ++s) {
      const std::size_t i = ray * intervals.per_ray + s, edge = i + ray;
      const T t = T(0.5) * (T(intervals.edges[edge]) + T(intervals.edges[edge + 1]));
      T world[3], d_unit[3], d_world[3];
      for (int k = 0; k < 3; ++k) {
        world[k] = T(rays.origin[k * n_rays + ray]) + t * T(rays.direction[k * n_rays + ray]);
        d_unit[k] = T(d_position[k * n + i]);
      }
      contract_adjoint(contraction, world, d_unit, d_world);
      for (int k = 0; k < 3; ++k) {
        origin[k] += d_world[k];
        direction[k] += t * d_world[k];
      }
    }
    for (int k = 0; k < 3; ++k) {
      d_origin[k * n_rays + ray] = static_cast<float>(origin[k]);
      d_direction[k * n_rays + ray] = static_cast<float>(direction[k]);
    }
  }
};

struct RayWeights {
  Intervals intervals;
  std::span<const float> density;
  std::span<float> weights;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray;
    ray_weights(&intervals.edges[first + ray], &density[first], intervals.per_ray, &weights[first]);
  }
};

struct RayWeightsBackward {
  Intervals intervals;
  std::span<const float> density, weights, d_weights;
  std::span<float> d_density;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray;
    ray_weights_adjoint(&intervals.edges[first + ray], &density[first], intervals.per_ray,
                        &weights[first], &d_weights[first], &d_density[first]);
  }
};

struct MedianDepths {
  Intervals intervals;
  std::span<const float> weights, opacity;
  std::span<float> depth;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray;
    depth[ray] = median_distance(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                                 opacity[ray]);
  }
};

}  // namespace redrive::kernels
