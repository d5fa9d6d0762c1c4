// SPDX-License-Identifier: Apache-2.0
// The hash grid's stages of grid_stages.h on a device, as functors in float for one point, or one
// point in one level. Their spans are on the device.
#pragma once

#include <cmath>

#include "redrive/kernels/device/device_math.h"
#include "redrive/kernels/grid_stages.h"

namespace redrive::kernels {

/// A hash grid as a functor's argument.
struct GridLevels {
  static constexpr int kMost = 16;
  HashGridLevel level[kMost];
  int n_levels, features_per_level;
  std::span<const float> table;

  explicit GridLevels(const HashGrid& grid)
      : n_levels(grid.config.n_levels),
        features_per_level(grid.config.features_per_level),
        table(grid.table) {
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

/// Encodes point i % n in level i / n, so that neighbouring threads read the same table.
struct EncodePoints {
  GridLevels grid;
  UnitPoints points;
  std::span<float> features;

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::size_t point = i % points.n;
    hash_grid_encode_level(grid.level[i / points.n], grid.features_per_level, grid.table.data(),
                           PointPosition(points, point).at, points.footprint[point],
                           &features[i * grid.features_per_level]);
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
    hash_grid_adjoint_level(grid.level[i / points.n], grid.features_per_level,
                            PointPosition(points, point).at, points.footprint[point],
                            &d_features[i * grid.features_per_level], add);
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
    for (int l = 0; l < grid.n_levels; ++l)
      hash_grid_position_adjoint_level(
          grid.level[l], grid.features_per_level, grid.table.data(), position.at,
          points.footprint[point], &d_features[(l * points.n + point) * grid.features_per_level],
          d);
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
    for (int l = 0; l < grid.n_levels; ++l) {
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

}  // namespace redrive::kernels
