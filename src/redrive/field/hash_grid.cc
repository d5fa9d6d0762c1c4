// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/hash_grid.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {

std::vector<HashGridLevel> hash_grid_levels(const HashGridConfig& config) {
  REDRIVE_CHECK(config.n_levels >= 1 && config.n_levels <= 16);
  REDRIVE_CHECK(config.features_per_level == 1 || config.features_per_level == 2 ||
                config.features_per_level == 4 || config.features_per_level == 8);
  REDRIVE_CHECK(config.log2_hashmap_size >= 4 && config.log2_hashmap_size <= 24);
  REDRIVE_CHECK(config.base_resolution >= 1 && config.base_resolution <= config.max_resolution &&
                config.max_resolution <= 1 << 20);
  REDRIVE_CHECK(config.min_level_weight >= 0 && config.min_level_weight < 1);
  const double growth = config.n_levels > 1
                            ? std::pow(double(config.max_resolution) / config.base_resolution,
                                       1.0 / (config.n_levels - 1))
                            : 1;
  std::vector<HashGridLevel> levels;
  std::size_t offset = 0;
  for (int l = 0; l < config.n_levels; ++l) {
    HashGridLevel level;
    level.resolution = static_cast<int>(std::lround(config.base_resolution * std::pow(growth, l)));
    const double vertices = std::pow(level.resolution + 2.0, 3);
    level.dense = vertices <= double(1u << config.log2_hashmap_size);
    level.rows =
        level.dense ? static_cast<std::uint32_t>(vertices) : 1u << config.log2_hashmap_size;
    level.offset = offset;
    level.min_weight = config.min_level_weight;
    offset += std::size_t(level.rows) * config.features_per_level;
    offset = (offset + 15) / 16 * 16;  // levels begin at a cache line
    levels.push_back(level);
  }
  return levels;
}

std::size_t hash_grid_size(const HashGridConfig& config) {
  const HashGridLevel last = hash_grid_levels(config).back();
  return (last.offset + std::size_t(last.rows) * config.features_per_level + 15) / 16 * 16;
}

void hash_grid_initialize(const HashGridConfig& config, std::uint64_t seed,
                          std::span<float> table) {
  REDRIVE_CHECK_OP(table.size(), ==, hash_grid_size(config));
  const std::uint64_t key = random_key(seed, kStreamInit, 1);
  for (std::size_t i = 0; i < table.size(); ++i) table[i] = 1e-4f * (2 * random_unit(key, i) - 1);
}

}  // namespace redrive
