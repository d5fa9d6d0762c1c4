// SPDX-License-Identifier: Apache-2.0
// Inner loops of --method grid as a table of functions, compiled once per vector width.
// cpu_grid_stages.cc cuts the work and owns the memory. Formulas: field/hash_grid.h,
// field/grid_field.h and field/contraction.h.
#pragma once

#include <cstddef>
#include <cstdint>

namespace redrive::kernels {

/// A level of a hash grid; `rows` points at its first feature.
struct GridLevel {
  int resolution = 0;
  std::uint32_t mask = 0;  ///< rows - 1, for a hashed level
  bool dense = true;
  const float* rows = nullptr;
  float min_weight = 0;  ///< HashGridLevel::min_weight
};

/// n points: coordinate k of point i at position[k * stride + i].
struct GridPoints {
  std::size_t n = 0;
  const float* position = nullptr;
  std::size_t stride = 0;
  const float* footprint = nullptr;
};

/// Weights of both MLPs: each matrix [inputs, outputs] for the forward pass (suffix _in; colour_out
/// padded to 16 outputs) and [outputs, inputs] for the backward pass.
struct GridNetworkWeights {
  int width = 0, inputs = 0, colour_layers = 1;
  float density_scale = 1;
  const float *density0_in = nullptr, *density1_in = nullptr, *geometry_in = nullptr,
              *harmonics_in = nullptr, *colour1_in = nullptr, *colour_out_in = nullptr;
  const float *density0 = nullptr, *density1 = nullptr, *colour0 = nullptr, *colour1 = nullptr,
              *colour_out = nullptr;
};

/// Gradients of both MLPs, [outputs, inputs], added to; harmonics and geometry features share
/// colour0, [width, 32].
struct GridNetworkGradients {
  float *density0 = nullptr, *density1 = nullptr, *colour0 = nullptr, *colour1 = nullptr,
        *colour_out = nullptr;
};

/// Whole rays of one network pass: feature f of level l of sample i at features[l * level_stride +
/// i * features_per_level + f], harmonics [n_rays, 16], channel k of sample i at raw[k * raw_stride
/// + i].
struct GridNetworkTile {
  int n_rays = 0, per_ray = 0;
  const float *features = nullptr, *harmonics = nullptr;
  int n_levels = 0, features_per_level = 0;
  std::size_t level_stride = 0, raw_stride = 0;
};

/// Floats of scratch memory of a tile.
static constexpr std::size_t grid_network_scratch(std::size_t samples, std::size_t rays, int width,
                                                  int inputs) {
  return samples * (2 * static_cast<std::size_t>(inputs) + 5 * static_cast<std::size_t>(width) +
                    4 * 16 + 16) +
         rays * 2 * static_cast<std::size_t>(width) + 256;
}

/// Midpoints of intervals to contract (kernels/grid/grid_stages.h), rays [0, n_rays).
struct GridRays {
  int n_rays = 0, per_ray = 0;
  const float *origin = nullptr,
              *direction = nullptr;  ///< coordinate k of a ray at [k * ray_stride + ray]
  std::size_t ray_stride = 0;
  const float *pixel_angle = nullptr, *edges = nullptr;
  const float* center = nullptr;
  float half_m = 1;
  bool unbounded = true;
  float least_width = 0;
  float *position = nullptr,
        *footprint = nullptr;  ///< coordinate k of sample i at position[k * stride + i]
  std::size_t stride = 0;
};

struct GridKernels {
  void (*contract)(const GridRays& rays);
  /// Writes out [n, features].
  void (*encode)(int features, const GridLevel& level, const GridPoints& points, float* out);
  /// Adds to d_rows and to d_position[k * points.stride + i]; either may be null.
  void (*encode_backward)(int features, const GridLevel& level, const GridPoints& points,
                          const float* d_out, float* d_rows, float* d_position);
  /// Writes scale * exp(sum over the levels), one feature each.
  void (*density)(const GridLevel* levels, int n_levels, float scale, const GridPoints& points,
                  float* density);
  /// volume/ray_weights.h for each ray; scratch: per_ray + 16 floats.
  void (*weights)(int n_rays, int per_ray, const float* edges, const float* density, float* weights,
                  float* scratch);
  void (*weights_backward)(int n_rays, int per_ray, const float* edges, const float* density,
                           const float* weights, const float* d_weights, float* d_density,
                           float* scratch);
  void (*network_forward)(const GridNetworkWeights& weights, const GridNetworkTile& tile,
                          float* raw, float* scratch);
  void (*network_backward)(const GridNetworkWeights& weights, const GridNetworkTile& tile,
                           const float* d_raw, const GridNetworkGradients& gradients,
                           float* d_features, float* scratch);
};

namespace avx2 {
extern const GridKernels kGridKernels;
}
namespace avx512 {
extern const GridKernels kGridKernels;
}

}  // namespace redrive::kernels
