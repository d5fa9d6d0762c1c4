// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/grid/cpu/packed_network.h"

#include <bit>
#include <cmath>

#include "redrive/base/error.h"

namespace redrive::kernels {
namespace {

constexpr int kColourInputs = kGeometryFeatures + kHarmonics;

/// Nearest, ties to even; NaN stays NaN.
bf16::Bf16 nearest_bf16(float x) {
  const auto bits = std::bit_cast<std::uint32_t>(x);
  if (std::isnan(x)) return static_cast<bf16::Bf16>(bits >> 16 | 0x40);
  return static_cast<bf16::Bf16>((bits + 0x7fff + (bits >> 16 & 1)) >> 16);
}

/// The first number of a layer's matrix.
auto layers_of(const GridNetwork& network) {
  return [&network](int layer) {
    return network.weights.data() + grid_layer(network.config, layer).offset;
  };
}

}  // namespace

PackedNetwork::PackedNetwork(const GridNetwork& network)
    : memory_(network.weights.size() + 16 * kMaxGridWidth) {
  const GridFieldConfig& config = network.config;
  const int width = config.width;
  weights_ = {.width = width,
              .inputs = config.grid.outputs(),
              .colour_layers = config.colour_layers,
              .density_scale = network.density_scale};
  const auto at = layers_of(network);
  weights_.density0 = at(kGridDensity0);
  weights_.density1 = at(kGridDensity1);
  weights_.colour0 = at(kGridColour0);
  weights_.colour1 = at(kGridColour1);
  weights_.colour_out = at(kGridColourOut);
  weights_.density0_in = pack(weights_.density0, weights_.inputs, width, weights_.inputs, width);
  weights_.density1_in =
      pack(weights_.density1, width, kGeometryFeatures, width, kGeometryFeatures);
  weights_.geometry_in = pack(weights_.colour0, kColourInputs, width, kGeometryFeatures, width);
  weights_.harmonics_in =
      pack(weights_.colour0 + kGeometryFeatures, kColourInputs, width, kHarmonics, width);
  if (config.colour_layers == 2)
    weights_.colour1_in = pack(weights_.colour1, width, width, width, width);
  weights_.colour_out_in = pack(weights_.colour_out, width, 3, width, 16);
}

const float* PackedNetwork::pack(const float* from, int from_row, int rows, int columns,
                                 int to_row) {
  float* const to = memory_.data() + used_;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c) to[c * to_row + r] = from[r * from_row + c];
  used_ += static_cast<std::size_t>(columns) * to_row;
  REDRIVE_CHECK_OP(used_, <=, memory_.size());
  return to;
}

PackedBf16Network::PackedBf16Network(const GridNetwork& network)
    : memory_(2 * network.weights.size() + 2 * kMaxGridWidth) {
  const GridFieldConfig& config = network.config;
  const int width = config.width, inputs = config.grid.outputs();
  weights_ = {.width = width,
              .inputs = inputs,
              .colour_layers = config.colour_layers,
              .density_scale = network.density_scale};
  const auto at = layers_of(network);
  const auto back = [](const Matrix& m) {
    return Matrix{m.from, m.inputs, m.outputs, m.input, m.output};
  };
  const Matrix density0{at(kGridDensity0), width, inputs, inputs},
      density1{at(kGridDensity1), kGeometryFeatures, width, width},
      geometry{at(kGridColour0), width, kGeometryFeatures, kColourInputs},
      harmonics{at(kGridColour0) + kGeometryFeatures, width, kHarmonics, kColourInputs},
      colour1{at(kGridColour1), width, width, width},
      colour_out{at(kGridColourOut), 3, width, width};
  weights_.density0 = pack(density0);
  weights_.density0_back = pack(back(density0));
  weights_.density1 = pack(density1);
  weights_.density1_back = pack(back(density1));
  weights_.geometry = pack(geometry);
  weights_.geometry_back = pack(back(geometry));
  weights_.harmonics = pack(harmonics);
  if (config.colour_layers == 2) {
    weights_.colour1 = pack(colour1);
    weights_.colour1_back = pack(back(colour1));
  }
  weights_.colour_out = pack(colour_out, 4);
  weights_.colour_out_back = pack(back(colour_out));
}

const bf16::Bf16* PackedBf16Network::pack(const Matrix& m, int block) {
  bf16::Bf16 *const first = memory_.data() + used_, *to = first;
  for (int o = 0; o < m.outputs; o += block)
    for (int i = 0; i < (m.inputs + 3) / 4 * 4; i += 2)
      for (int r = o; r < o + block; ++r)
        for (int k = i; k < i + 2; ++k)
          *to++ = r < m.outputs && k < m.inputs ? nearest_bf16(m.from[r * m.output + k * m.input])
                                                : bf16::Bf16{0};
  used_ += static_cast<std::size_t>(to - first);
  REDRIVE_CHECK_OP(used_, <=, memory_.size());
  return first;
}

}  // namespace redrive::kernels
