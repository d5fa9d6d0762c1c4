// SPDX-License-Identifier: Apache-2.0
// The network of field/nerf_field.h on one sample, forward and backward, for any scalar type, as
// plain loops: the oracle of every NerfNetwork. Tests run it on Jets (Ceres' dual numbers),
// RefBackend in double.
#pragma once

#include <array>
#include <vector>

#include "redrive/field/activation.h"
#include "redrive/field/nerf_field.h"
#include "redrive/field/positional_encoding.h"

namespace redrive::kernels::ref {

/// Activations of the forward pass that the backward pass reads: each layer's input and output
/// (after its ReLU, if it has one).
template <class T>
struct NerfActivations {
  std::array<std::vector<T>, kNerfLayers> input, output;
};

constexpr bool nerf_layer_has_relu(int layer) {
  return layer < kNerfHidden || layer == kNerfColour;
}

/// output = W input + b, then ReLU where the layer has one.
template <class T>
void nerf_layer_forward(const NerfConfig& config, int layer, const T* parameters,
                        NerfActivations<T>* a) {
  const NerfLayerShape shape = nerf_layer(config, layer);
  const std::vector<T>& input = a->input[layer];
  std::vector<T>& output = a->output[layer];
  output.resize(shape.outputs);
  for (int o = 0; o < shape.outputs; ++o) {
    const T* row = parameters + shape.weight + static_cast<std::size_t>(o) * shape.inputs;
    T sum = parameters[shape.bias + o];
    for (int i = 0; i < shape.inputs; ++i) sum += row[i] * input[i];
    output[o] = nerf_layer_has_relu(layer) ? relu(sum) : sum;
  }
}

/// Adds dL/dW = d_output input^T and dL/db = d_output to `gradients` and returns dL/d input = W^T
/// d_output. Sets d_output to 0 first where the ReLU is closed.
template <class T>
std::vector<T> nerf_layer_adjoint(const NerfConfig& config, int layer, const T* parameters,
                                  const NerfActivations<T>& a, std::vector<T> d_output,
                                  T* gradients) {
  const NerfLayerShape shape = nerf_layer(config, layer);
  const std::vector<T>& input = a.input[layer];
  std::vector<T> d_input(shape.inputs, T(0));
  for (int o = 0; o < shape.outputs; ++o) {
    if (nerf_layer_has_relu(layer) && a.output[layer][o] <= T(0)) continue;
    const std::size_t row = shape.weight + static_cast<std::size_t>(o) * shape.inputs;
    gradients[shape.bias + o] += d_output[o];
    for (int i = 0; i < shape.inputs; ++i) {
      gradients[row + i] += d_output[o] * input[i];
      d_input[i] += parameters[row + i] * d_output[o];
    }
  }
  return d_input;
}

/// position: in the unit cube; direction: unit length. raw: r, g, b before the sigmoid, density
/// before the ReLU.
template <class T>
void nerf_sample_forward(const NerfConfig& config, const T* parameters, const T position[3],
                         const T direction[3], NerfActivations<T>* a, T raw[4]) {
  std::vector<T> gamma_x(encoded_size(config.position_octaves)),
      gamma_d(encoded_size(config.direction_octaves));
  positional_encoding(position, config.position_octaves, gamma_x.data());
  positional_encoding(direction, config.direction_octaves, gamma_d.data());

  for (int layer = 0; layer < kNerfHidden; ++layer) {
    a->input[layer] = layer == 0 ? gamma_x : a->output[layer - 1];
    if (layer == kNerfSkip)
      a->input[layer].insert(a->input[layer].end(), gamma_x.begin(), gamma_x.end());
    nerf_layer_forward(config, layer, parameters, a);
  }
  a->input[kNerfDensity] = a->input[kNerfFeature] = a->output[kNerfHidden - 1];
  nerf_layer_forward(config, kNerfDensity, parameters, a);
  nerf_layer_forward(config, kNerfFeature, parameters, a);
  a->input[kNerfColour] = a->output[kNerfFeature];
  a->input[kNerfColour].insert(a->input[kNerfColour].end(), gamma_d.begin(), gamma_d.end());
  nerf_layer_forward(config, kNerfColour, parameters, a);
  a->input[kNerfRgb] = a->output[kNerfColour];
  nerf_layer_forward(config, kNerfRgb, parameters, a);

  for (int k = 0; k < 3; ++k) raw[k] = a->output[kNerfRgb][k];
  raw[3] = a->output[kNerfDensity][0];
}

/// Adds d loss / d parameters of this sample to `gradients`. d_raw: d loss / d raw; activations:
/// from the sample's forward pass. Writes d_position [3], d loss / d position, unless null. The
/// colour's dependence on the direction is ignored.
template <class T>
void nerf_sample_adjoint(const NerfConfig& config, const T* parameters, const NerfActivations<T>& a,
                         const T d_raw[4], T* gradients, T* d_position = nullptr) {
  std::vector<T> d = nerf_layer_adjoint(config, kNerfRgb, parameters, a,
                                        {d_raw[0], d_raw[1], d_raw[2]}, gradients);
  d = nerf_layer_adjoint(config, kNerfColour, parameters, a, std::move(d),
                         gradients);  // gradient of [feature, gamma(d)]
  d = nerf_layer_adjoint(config, kNerfFeature, parameters, a, std::move(d), gradients);
  const std::vector<T> of_density =
      nerf_layer_adjoint(config, kNerfDensity, parameters, a, {d_raw[3]}, gradients);
  for (int i = 0; i < config.width; ++i) d[i] += of_density[i];
  std::vector<T> d_gamma(encoded_size(config.position_octaves), T(0));
  for (int layer = kNerfHidden - 1; layer >= 0; --layer) {
    d = nerf_layer_adjoint(config, layer, parameters, a, std::move(d), gradients);
    // At the skip, the first `width` entries of d belong to h and the rest to gamma(x), which is
    // layer 0's input.
    if (layer == kNerfSkip || layer == 0)
      for (std::size_t i = 0; i < d_gamma.size(); ++i)
        d_gamma[i] += d[d.size() - d_gamma.size() + i];
  }
  if (d_position)
    positional_encoding_adjoint(a.input[0].data(), config.position_octaves, d_gamma.data(),
                                d_position);
}

}  // namespace redrive::kernels::ref
