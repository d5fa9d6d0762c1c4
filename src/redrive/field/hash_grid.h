// SPDX-License-Identifier: Apache-2.0
// Multiresolution hash encoding of a position (Mueller et al., "Instant Neural Graphics Primitives
// with a Multiresolution Hash Encoding", SIGGRAPH 2022, section 3), on any scalar type, with its
// adjoint.
//
// A level is a grid of cells over the unit cube with a row of features at each vertex; a point's
// feature is the trilinear interpolation of its cell's eight rows. Resolutions grow geometrically
// from base_resolution to max_resolution. A level with more than 2^log2_hashmap_size vertices
// stores that many rows and finds them by a hash. Grids are offset by half a cell, so that the
// kinks of different levels do not coincide.
#pragma once

#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "redrive/base/value_of.h"
#include "redrive/field/constants.h"

namespace redrive {

struct HashGridConfig {
  int n_levels = 8;               ///< 1..16
  int features_per_level = 4;     ///< 1, 2, 4 or 8
  int base_resolution = 16;       ///< cells along a side of the coarsest level, >= 1
  int max_resolution = 2048;      ///< cells along a side of the finest level, base_resolution..2^20
  int log2_hashmap_size = 17;     ///< log2 of the most rows of a level, 4..24
  float min_level_weight = 0.2f;  ///< levels of a smaller weight are skipped; in [0, 1)

  int outputs() const { return n_levels * features_per_level; }
  bool operator==(const HashGridConfig&) const = default;
};

struct HashGridLevel {
  int resolution = 0;      ///< cells along a side
  std::uint32_t rows = 0;  ///< a power of two where hashed
  bool dense = true;       ///< one row for each vertex, no hash
  std::size_t offset = 0;  ///< index of its first row's first feature in the table
  float min_weight = 0;    ///< HashGridConfig::min_level_weight
};

/// Returns the levels, coarsest first. Throws std::logic_error for a config out of range.
std::vector<HashGridLevel> hash_grid_levels(const HashGridConfig& config);
std::size_t hash_grid_size(const HashGridConfig& config);  ///< floats of the table

/// Fills the table with U(-1e-4, 1e-4), as the paper. A function of the seed.
void hash_grid_initialize(const HashGridConfig& config, std::uint64_t seed, std::span<float> table);

/// Returns the row of a vertex within its level; coordinates in 0..resolution + 1. The paper's hash
/// (eq. 4) with x added instead of xored: rows of neighbours along x are consecutive, so that both
/// are one load, except that the last row of a hashed level is followed by its first.
inline std::uint32_t hash_grid_row(const HashGridLevel& level, std::uint32_t x, std::uint32_t y,
                                   std::uint32_t z) {
  const std::uint32_t side = static_cast<std::uint32_t>(level.resolution) + 2;
  if (level.dense) return x + side * (y + side * z);
  return (x + ((y * kHashPrimeY) ^ (z * kHashPrimeZ))) & (level.rows - 1);
}

/// Returns the weight of a level in 0..1 by the size of the sample (Tonderski et al., "NeuRAD",
/// 2024, section 3.1): w = 1 / max(1, 2 resolution footprint), then max(0, w - level.min_weight) /
/// (1 - level.min_weight) where w < 1. `footprint`: standard deviation of the sample's volume in
/// the unit cube; 0 gives weight 1, infinity 0, NaN 1.
template <class T>
T hash_grid_level_weight(const HashGridLevel& level, T footprint) {
  const T widths = T(2.0 * level.resolution) * footprint;
  if (!(widths > T(1))) return T(1);
  const T above = T(1) / widths - T(level.min_weight);
  return above > T(0) ? above / (T(1) - T(level.min_weight)) : T(0);
}

/// The cell that holds a point: coordinates of its first vertex, and the position within it in [0,
/// 1).
template <class T>
struct HashGridCell {
  std::uint32_t corner[3];
  T fraction[3];

  /// Clamps positions outside the unit cube to its faces; NaN becomes 0.
  HashGridCell(const HashGridLevel& level, const T position[3]) {
    for (int k = 0; k < 3; ++k) {
      const T inside = position[k] > T(0) ? (position[k] < T(1) ? position[k] : T(1)) : T(0);
      const T scaled = inside * T(level.resolution) + T(0.5);
      const auto below = static_cast<std::uint32_t>(value_of(scaled));
      corner[k] = below;
      fraction[k] = scaled - T(below);
    }
  }

  /// Row of vertex `c` (bit k of c set: the far one along axis k), and its interpolation weight.
  std::uint32_t row(const HashGridLevel& level, int c) const {
    return hash_grid_row(level, corner[0] + (c & 1), corner[1] + (c >> 1 & 1),
                         corner[2] + (c >> 2 & 1));
  }
  T share(int c, int axis) const {
    return (c >> axis & 1) ? fraction[axis] : T(1) - fraction[axis];
  }
  T weight(int c) const { return share(c, 0) * share(c, 1) * share(c, 2); }
};

/// Writes the features of one level, features[features_per_level]. Table and position may differ in
/// type.
template <class Table, class T, class Out>
void hash_grid_encode_level(const HashGridLevel& level, int features_per_level, const Table* table,
                            const T position[3], T footprint, Out* features) {
  const HashGridCell<T> cell(level, position);
  for (int f = 0; f < features_per_level; ++f) features[f] = Out(0);
  for (int c = 0; c < 8; ++c) {
    const Table* const row =
        table + level.offset + std::size_t(cell.row(level, c)) * features_per_level;
    for (int f = 0; f < features_per_level; ++f) features[f] += Out(cell.weight(c)) * Out(row[f]);
  }
  const T weight = hash_grid_level_weight(level, footprint);
  for (int f = 0; f < features_per_level; ++f) features[f] *= Out(weight);
}

/// Writes features[level * config.features_per_level + f] of all levels. `levels`:
/// hash_grid_levels(config).
template <class Table, class T, class Out>
void hash_grid_encode(const HashGridConfig& config, std::span<const HashGridLevel> levels,
                      const Table* table, const T position[3], T footprint, Out* features) {
  for (std::size_t l = 0; l < levels.size(); ++l)
    hash_grid_encode_level(levels[l], config.features_per_level, table, position, footprint,
                           features + l * config.features_per_level);
}

/// Calls add(index in the table, its derivative) for each row of one level. The caller decides how
/// concurrent additions are ordered.
template <class T, class Add>
void hash_grid_adjoint_level(const HashGridLevel& level, int features_per_level,
                             const T position[3], T footprint, const T* d_features,
                             const Add& add) {
  const HashGridCell<T> cell(level, position);
  const T level_weight = hash_grid_level_weight(level, footprint);
  for (int c = 0; c < 8; ++c) {
    const std::size_t row = level.offset + std::size_t(cell.row(level, c)) * features_per_level;
    for (int f = 0; f < features_per_level; ++f)
      add(row + f, cell.weight(c) * level_weight * d_features[f]);
  }
}

/// Adds one level's part to d_position[3]. The footprint is taken as constant.
template <class T>
void hash_grid_position_adjoint_level(const HashGridLevel& level, int features_per_level,
                                      const T* table, const T position[3], T footprint,
                                      const T* d_features, T* d_position) {
  const HashGridCell<T> cell(level, position);
  const T level_weight = hash_grid_level_weight(level, footprint);
  for (int c = 0; c < 8; ++c) {
    const std::size_t row = level.offset + std::size_t(cell.row(level, c)) * features_per_level;
    T dot(0);
    for (int f = 0; f < features_per_level; ++f) dot += table[row + f] * d_features[f];
    const T slope = dot * level_weight * T(level.resolution);
    for (int k = 0; k < 3; ++k)
      d_position[k] +=
          ((c >> k & 1) ? slope : -slope) * cell.share(c, (k + 1) % 3) * cell.share(c, (k + 2) % 3);
  }
}

/// Adds to d_table, and to d_position[3] unless that is null.
template <class T>
void hash_grid_adjoint(const HashGridConfig& config, std::span<const HashGridLevel> levels,
                       const T* table, const T position[3], T footprint, const T* d_features,
                       T* d_table, T* d_position) {
  for (std::size_t l = 0; l < levels.size(); ++l) {
    const T* const d = d_features + l * config.features_per_level;
    hash_grid_adjoint_level(
        levels[l], config.features_per_level, position, footprint, d,
        [&](std::size_t at, const T& derivative) { d_table[at] += derivative; });
    if (d_position)
      hash_grid_position_adjoint_level(levels[l], config.features_per_level, table, position,
                                       footprint, d, d_position);
  }
}

}  // namespace redrive
