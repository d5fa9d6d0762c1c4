// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/grid_field.h"

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {

GridLayerShape grid_layer(const GridFieldConfig& config, int layer) {
  REDRIVE_CHECK(layer >= 0 && layer < kGridLayers);
  REDRIVE_CHECK(config.width >= 16 && config.width <= kMaxGridWidth && config.width % 16 == 0);
  REDRIVE_CHECK(config.colour_layers == 1 || config.colour_layers == 2);
  const int width = config.width, colour_1 = config.colour_layers == 2 ? width : 0;
  const GridLayerShape shapes[kGridLayers] = {
      {"density.0.weight", width, config.grid.outputs()},
      {"density.1.weight", kGeometryFeatures, width},
      {"colour.0.weight", width, kGeometryFeatures + kHarmonics},
      {"colour.1.weight", colour_1, width},
      {"colour.out.weight", 3, width}};
  GridLayerShape shape = shapes[layer];
  for (int l = 0; l < layer; ++l)
    shape.offset += static_cast<std::size_t>(shapes[l].outputs) * shapes[l].inputs;
  return shape;
}

std::size_t grid_network_size(const GridFieldConfig& config) {
  const GridLayerShape last = grid_layer(config, kGridColourOut);
  return last.offset + static_cast<std::size_t>(last.outputs) * last.inputs;
}

double grid_macs_per_sample(const GridFieldConfig& config) {
  return static_cast<double>(grid_network_size(config));
}

void grid_network_initialize(const GridFieldConfig& config, std::uint64_t seed,
                             std::span<float> weights) {
  REDRIVE_CHECK_OP(weights.size(), ==, grid_network_size(config));
  const std::uint64_t key = random_key(seed, kStreamInit, 2);
  for (int layer = 0; layer < kGridLayers; ++layer) {
    const GridLayerShape shape = grid_layer(config, layer);
    const float bound = std::sqrt(6.0f / static_cast<float>(shape.inputs));
    const std::size_t size = static_cast<std::size_t>(shape.outputs) * shape.inputs;
    for (std::size_t i = shape.offset; i < shape.offset + size; ++i)
      weights[i] = bound * (2 * random_unit(key, i) - 1);
  }
}

}  // namespace redrive
