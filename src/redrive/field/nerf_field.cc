// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/nerf_field.h"

#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {
namespace {

struct Size {
  int outputs, inputs;
};

Size layer_size(const NerfConfig& config, int layer) {
  const int width = config.width;
  const int position = encoded_size(config.position_octaves),
            direction = encoded_size(config.direction_octaves);
  switch (layer) {
    case 0: return {width, position};
    case kNerfSkip: return {width, width + position};
    case kNerfDensity: return {1, width};
    case kNerfFeature: return {width, width};
    case kNerfColour: return {width / 2, width + direction};
    case kNerfRgb: return {3, width / 2};
    default: return {width, width};
  }
}

std::string layer_name(int layer) {
  switch (layer) {
    case kNerfDensity: return "density";
    case kNerfFeature: return "feature";
    case kNerfColour: return "colour";
    case kNerfRgb: return "rgb";
    default: return "trunk." + std::to_string(layer);
  }
}

}  // namespace

// Layers follow each other in the order of their indices, each its weight, then its bias.
NerfLayerShape nerf_layer(const NerfConfig& config, int layer) {
  REDRIVE_CHECK_OP(layer, >=, 0);
  REDRIVE_CHECK_OP(layer, <, static_cast<int>(kNerfLayers));
  NerfLayerShape shape;
  std::size_t offset = 0;
  for (int l = 0; l <= layer; ++l) {
    const Size size = layer_size(config, l);
    shape.outputs = size.outputs;
    shape.inputs = size.inputs;
    shape.weight = offset;
    shape.bias = offset + static_cast<std::size_t>(size.outputs) * size.inputs;
    offset = shape.bias + size.outputs;
  }
  return shape;
}

std::size_t nerf_parameter_count(const NerfConfig& config) {
  const NerfLayerShape last = nerf_layer(config, kNerfLayers - 1);
  return last.bias + last.outputs;
}

std::vector<NerfTensor> nerf_tensors(const NerfConfig& config) {
  std::vector<NerfTensor> tensors;
  for (int layer = 0; layer < kNerfLayers; ++layer) {
    const NerfLayerShape shape = nerf_layer(config, layer);
    tensors.push_back({layer_name(layer) + ".weight", shape.outputs, shape.inputs, shape.weight});
    tensors.push_back({layer_name(layer) + ".bias", shape.outputs, 1, shape.bias});
  }
  return tensors;
}

double nerf_macs_per_sample(const NerfConfig& config) {
  double macs = 0;
  for (int layer = 0; layer < kNerfLayers; ++layer) {
    const Size size = layer_size(config, layer);
    macs += static_cast<double>(size.outputs) * size.inputs;
  }
  return macs;
}

void nerf_initialize(const NerfConfig& config, std::uint64_t seed, std::span<float> parameters) {
  REDRIVE_CHECK_OP(parameters.size(), ==, nerf_parameter_count(config));
  for (int layer = 0; layer < kNerfLayers; ++layer) {
    const NerfLayerShape shape = nerf_layer(config, layer);
    const std::uint64_t key = random_key(seed, kStreamInit, layer);
    const float bound = static_cast<float>(std::sqrt(6.0 / (shape.inputs + shape.outputs)));
    for (std::size_t i = shape.weight; i < shape.bias; ++i)
      parameters[i] = bound * (2 * random_unit(key, i - shape.weight) - 1);
    for (int i = 0; i < shape.outputs; ++i) parameters[shape.bias + i] = 0;
  }
}

}  // namespace redrive
