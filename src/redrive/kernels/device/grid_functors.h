// SPDX-License-Identifier: Apache-2.0
// The stages of grid_stages.h but for the networks: what is done for one ray, or for one point and
// level, in float, by the scalar functions. Spans lie on the device.
#pragma once

#include <cmath>

#include "redrive/kernels/check_grid_sizes.h"
#include "redrive/kernels/device/device_math.h"
#include "redrive/optim/proposal_loss.h"
#include "redrive/optim/range_loss.h"
#include "redrive/optim/sparsity_loss.h"
#include "redrive/volume/ray_weights.h"

namespace redrive::kernels {

struct SampleUniform {
  Rays rays;
  UniformSampling how;
  std::span<float> edges;

  REDRIVE_HD void operator()(std::size_t ray) const { uniform_edges_of_ray(rays, how, ray, edges); }
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

struct ContractSamples {
  Contraction contraction;
  Rays rays;
  std::span<const float> pixel_angle;
  Intervals intervals;
  float least_width;
  std::span<float> position, footprint;

  REDRIVE_HD void operator()(std::size_t i) const {
    contract_sample(contraction, rays, pixel_angle, intervals, least_width, i / intervals.per_ray,
                    i % intervals.per_ray, position, footprint);
  }
};

struct ContractBackward {
  Contraction contraction;
  Rays rays;
  Intervals intervals;
  std::span<const float> d_position;
  std::span<float> d_origin, d_direction;

  REDRIVE_HD void operator()(std::size_t ray) const {
    contract_ray_backward<float>(contraction, rays, intervals, d_position, ray, d_origin,
                                 d_direction);
  }
};

/// A hash grid as functors carry it.
struct GridLevels {
  static constexpr int kMost = 16;
  HashGridLevel level[kMost];
  int levels, features;
  std::span<const float> table;

  explicit GridLevels(const HashGrid& grid)
      : levels(grid.config.levels), features(grid.config.features), table(grid.table) {
    const auto all = hash_grid_levels(grid.config);
    std::copy(all.begin(), all.end(), level);
  }
};

struct PointPosition {
  float at[3];

  REDRIVE_HD PointPosition(const UnitPoints& points, std::size_t i) {
    for (int k = 0; k < 3; ++k) at[k] = points.coordinate(k, i);
  }
};

/// Point i % n in level i / n: neighbours look into the same table.
struct EncodePoints {
  GridLevels grid;
  UnitPoints points;
  std::span<float> features;

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::size_t point = i % points.n;
    hash_grid_encode_level(grid.level[i / points.n], grid.features, grid.table.data(),
                           PointPosition(points, point).at, points.footprint[point],
                           &features[i * grid.features]);
  }
};

struct AtomicAddToTable {
  std::span<float> d_table;

  REDRIVE_HD void operator()(std::size_t at, float derivative) const {
    atomic_add(&d_table[at], derivative);
  }
};

struct EncodeTableBackward {
  GridLevels grid;
  UnitPoints points;
  std::span<const float> d_features;
  AtomicAddToTable add;

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::size_t point = i % points.n;
    hash_grid_adjoint_level(grid.level[i / points.n], grid.features,
                            PointPosition(points, point).at, points.footprint[point],
                            &d_features[i * grid.features], add);
  }
};

struct EncodePositionBackward {
  GridLevels grid;
  UnitPoints points;
  std::span<const float> d_features;
  std::span<float> d_position;

  REDRIVE_HD void operator()(std::size_t point) const {
    const PointPosition position(points, point);
    float d[3]{};
    for (int l = 0; l < grid.levels; ++l)
      hash_grid_position_adjoint_level(grid.level[l], grid.features, grid.table.data(), position.at,
                                       points.footprint[point],
                                       &d_features[(l * points.n + point) * grid.features], d);
    for (int k = 0; k < 3; ++k) d_position[k * points.n + point] = d[k];
  }
};

struct ProposalDensity {
  GridLevels grid;
  float density_scale;
  UnitPoints points;
  std::span<float> density;

  REDRIVE_HD void operator()(std::size_t point) const {
    const PointPosition position(points, point);
    const float most = kMaxLogDensity;
    float sum = 0;
    for (int l = 0; l < grid.levels; ++l) {
      float feature;
      hash_grid_encode_level(grid.level[l], 1, grid.table.data(), position.at,
                             points.footprint[point], &feature);
      sum += feature;
    }
    density[point] = density_scale * std::exp(sum > most ? most : sum);
  }
};

struct ProposalDensityBackward {
  GridLevels grid;
  UnitPoints points;
  std::span<const float> density, d_density;
  AtomicAddToTable add;

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::size_t point = i % points.n;
    const float d = density[point] * d_density[point];
    hash_grid_adjoint_level(grid.level[i / points.n], 1, PointPosition(points, point).at,
                            points.footprint[point], &d, add);
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

/// Returns the ray's loss.
struct ProposalLoss {
  int n_rays;
  Intervals intervals;
  std::span<const float> weights;
  Intervals proposal;
  std::span<const float> proposal_weights;
  std::span<float> d_proposal;

  REDRIVE_HD double operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray, p = ray * proposal.per_ray;
    for (int j = 0; j < proposal.per_ray; ++j) d_proposal[p + j] = 0;
    return proposal_loss(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                         &proposal.edges[p + ray], &proposal_weights[p], proposal.per_ray,
                         1.0f / static_cast<float>(n_rays), &d_proposal[p]);
  }
};

/// Returns the ray's loss.
struct RangeLoss {
  int n_rays;
  Intervals intervals;
  std::span<const float> weights, range_m;
  float spread_m, factor;
  std::span<float> d_weights;

  REDRIVE_HD double operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray;
    return range_loss(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                      range_m[ray], spread_m, factor / static_cast<float>(n_rays),
                      &d_weights[first]);
  }
};

/// Returns the ray's loss.
struct SparsityLoss {
  int n_rays;
  Intervals intervals;
  std::span<const float> density;
  float factor;
  std::span<float> d_density;

  REDRIVE_HD double operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray;
    return sparsity_loss(&intervals.edges[first + ray], &density[first], intervals.per_ray,
                         factor / static_cast<float>(n_rays), &d_density[first]);
  }
};

}  // namespace redrive::kernels
