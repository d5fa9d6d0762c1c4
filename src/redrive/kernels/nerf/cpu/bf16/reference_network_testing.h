// SPDX-License-Identifier: Apache-2.0
// For the tests: one sample through the network of field/nerf_field.h in plain loops over plain
// matrices, rounded to bf16 where the kernels round: weights, the activations between layers, the
// gradients between layers. Biases and their gradients are not. Feature and colour are one layer
// (folded_colour.h), whose weights are rounded as a whole.
//
// Sums that are rounded to bf16 follow the documented order of the instruction, so that the
// results are equal bit for bit. In another order a few activations would round to the other side,
// and differences would grow to the rounding noise itself, which allows no tight tolerance.
// Gradients of parameters are not rounded further: double.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "redrive/field/nerf_field.h"
#include "redrive/kernels/nerf/cpu/bf16/bf16_testing.h"

namespace redrive::kernels::bf16 {

class ReferenceNetwork {
 public:
  ReferenceNetwork(const NerfConfig& config, std::span<const float> parameters)
      : config_(config), exact_(parameters.begin(), parameters.end()) {
    fold();
    for (const float p : exact_) rounded_.push_back(round_bf16(p));
  }

  /// Size of the arrays that backward and unfold take: the network's parameters, then the folded
  /// layer's.
  std::size_t gradient_size() const { return exact_.size(); }

  struct Trace {
    std::vector<float> input[kNerfLayers];   ///< bf16 numbers
    std::vector<float> output[kNerfLayers];  ///< before activation and rounding
    float raw[4];
  };

  /// The encodings are bf16 numbers.
  Trace forward(std::span<const float> gamma_x, std::span<const float> gamma_d) const {
    Trace trace;
    std::vector<float> h(gamma_x.begin(), gamma_x.end());
    for (int layer = 0; layer < kNerfHidden; ++layer) {
      if (layer == kNerfSkip) h.insert(h.end(), gamma_x.begin(), gamma_x.end());
      h = relu(apply(trace, layer, h));
    }
    trace.raw[3] = apply(trace, kNerfDensity, h)[0];
    h.insert(h.end(), gamma_d.begin(), gamma_d.end());
    h = relu(apply(trace, kNerfColour, h));
    const std::vector<float> rgb = apply(trace, kNerfRgb, h);
    std::copy(rgb.begin(), rgb.end(), trace.raw);
    return trace;
  }

  /// Returns the gradient of gamma(x).
  std::vector<double> backward(const Trace& trace, const float d_raw[4],
                               std::span<double> gradients) const {
    std::vector<float> d(d_raw, d_raw + 3);
    d = masked(adjoint(trace, {kNerfRgb}, d, gradients), trace, kNerfColour);
    d.push_back(d_raw[3]);
    d = adjoint(trace, {kNerfColour, kNerfDensity}, d,
                gradients);  // one sum over both layers' outputs
    std::vector<double> d_gamma(trace.input[0].size());
    for (int layer = kNerfHidden - 1; layer >= 0; --layer) {
      d = adjoint(trace, {layer}, masked(d, trace, layer), gradients);
      if (layer == kNerfSkip || layer == 0)
        for (std::size_t i = 0; i < d_gamma.size(); ++i)
          d_gamma[i] += d[d.size() - d_gamma.size() + i];
    }
    return d_gamma;
  }

  /// Adds to the gradients of feature and colour those implied by the folded layer's, which follow
  /// the parameters'.
  void unfold(std::span<double> gradients) const {
    const NerfLayerShape feature = nerf_layer(config_, kNerfFeature),
                         colour = nerf_layer(config_, kNerfColour);
    const NerfLayerShape folded = layer_shape(kNerfColour);
    for (int o = 0; o < colour.outputs; ++o) {
      const std::size_t row = colour.weight + static_cast<std::size_t>(o) * colour.inputs;
      const double* d_row = &gradients[folded.weight + static_cast<std::size_t>(o) * folded.inputs];
      const double d_bias = gradients[folded.bias + o];
      gradients[colour.bias + o] += d_bias;
      for (int k = config_.width; k < colour.inputs; ++k) gradients[row + k] += d_row[k];
      for (int j = 0; j < config_.width; ++j) {
        const std::size_t feature_row =
            feature.weight + static_cast<std::size_t>(j) * feature.inputs;
        double sum = d_bias * exact_[feature.bias + j];
        for (int i = 0; i < feature.inputs; ++i) {
          sum += d_row[i] * exact_[feature_row + i];
          gradients[feature_row + i] += exact_[row + j] * d_row[i];
        }
        gradients[row + j] += sum;
        gradients[feature.bias + j] += exact_[row + j] * d_bias;
      }
    }
  }

 private:
  NerfLayerShape layer_shape(int layer) const {
    NerfLayerShape shape = nerf_layer(config_, layer);
    if (layer == kNerfColour) {
      shape.weight = nerf_parameter_count(config_);
      shape.bias = shape.weight + static_cast<std::size_t>(shape.outputs) * shape.inputs;
    }
    return shape;
  }

  /// Appends the folded layer to exact_; the sums in the order that folded_colour.h documents.
  void fold() {
    const NerfLayerShape feature = nerf_layer(config_, kNerfFeature),
                         colour = nerf_layer(config_, kNerfColour);
    std::vector<float> weight, bias;
    for (int o = 0; o < colour.outputs; ++o) {
      const float* colour_row =
          &exact_[colour.weight + static_cast<std::size_t>(o) * colour.inputs];
      std::vector<float> row(colour_row, colour_row + colour.inputs);
      std::fill_n(row.begin(), feature.inputs, 0.0f);
      bias.push_back(exact_[colour.bias + o]);
      for (int j = 0; j < feature.outputs; ++j) {
        const float* feature_row =
            &exact_[feature.weight + static_cast<std::size_t>(j) * feature.inputs];
        for (int i = 0; i < feature.inputs; ++i) row[i] += colour_row[j] * feature_row[i];
        bias.back() += colour_row[j] * exact_[feature.bias + j];
      }
      weight.insert(weight.end(), row.begin(), row.end());
    }
    exact_.insert(exact_.end(), weight.begin(), weight.end());
    exact_.insert(exact_.end(), bias.begin(), bias.end());
  }

  /// init + sum a(k) b(k), summed as VDPBF16PS does: per pair of k a fused multiply-add of the odd
  /// member, then of the even one.
  template <class A, class B>
  static float dot(float init, int n, const A& a, const B& b) {
    const auto times = [&](int k, float sum) { return k < n ? std::fma(a(k), b(k), sum) : sum; };
    for (int k = 0; k < n; k += 2) init = times(k, times(k + 1, init));
    return init;
  }

  std::vector<float> apply(Trace& trace, int layer, const std::vector<float>& input) const {
    const NerfLayerShape shape = layer_shape(layer);
    trace.input[layer] = input;
    for (int o = 0; o < shape.outputs; ++o) {
      const float* w = &rounded_[shape.weight + static_cast<std::size_t>(o) * shape.inputs];
      trace.output[layer].push_back(dot(
          exact_[shape.bias + o], shape.inputs, [&](int k) { return w[k]; },
          [&](int k) { return input[k]; }));
    }
    return trace.output[layer];
  }

  static std::vector<float> relu(std::vector<float> output) {
    for (float& x : output) x = round_bf16(std::max(x, 0.0f));
    return output;
  }

  static std::vector<float> masked(std::vector<float> d, const Trace& trace, int layer) {
    d.resize(trace.output[layer]
                 .size());  // the encoding's part follows the skip's input and goes to no layer
    for (std::size_t i = 0; i < d.size(); ++i) d[i] = trace.output[layer][i] > 0 ? d[i] : 0;
    return d;
  }

  /// d: concatenated gradients of the outputs of `layers`; all layers begin with the same inputs,
  /// the first has the most. Adds the gradients of their weights and biases; returns the gradient
  /// of the common inputs.
  std::vector<float> adjoint(const Trace& trace, const std::vector<int>& layers,
                             const std::vector<float>& d, std::span<double> gradients) const {
    std::vector<float> d_rounded;  // whole blocks of outputs
    std::vector<const float*> rows;
    std::size_t output = 0;
    for (const int layer : layers) {
      const NerfLayerShape shape = layer_shape(layer);
      const std::vector<float>& input = trace.input[layer];
      for (int o = 0; o < shape.outputs; ++o, ++output) {
        const std::size_t row = shape.weight + static_cast<std::size_t>(o) * shape.inputs;
        d_rounded.push_back(round_bf16(d[output]));
        gradients[shape.bias + o] += d[output];
        for (int k = 0; k < shape.inputs; ++k)
          gradients[row + k] += static_cast<double>(d_rounded.back()) * input[k];
        rows.push_back(&rounded_[row]);
      }
      for (; rows.size() % kBlock != 0; rows.push_back(rows.back())) d_rounded.push_back(0);
    }
    std::vector<float> d_input(trace.input[layers.back()].size());
    for (std::size_t i = 0; i < d_input.size(); ++i) {
      d_input[i] = dot(
          0, static_cast<int>(rows.size()), [&](int o) { return d_rounded[o]; },
          [&](int o) { return rows[o][i]; });
    }
    return d_input;
  }

  NerfConfig config_;
  std::vector<float> exact_, rounded_;
};

}  // namespace redrive::kernels::bf16
