// SPDX-License-Identifier: Apache-2.0
// For the tests: one sample through the network of field/nerf_field.h in plain loops over plain matrices, rounded to
// bf16 where the kernels round: weights, the activations between layers, the gradients between layers. Biases and
// their gradients are not.
//
// The sums that decide about a rounding are done in the order the instructions document, so that the results are
// equal bit for bit. With another order a few activations would round the other way, and from there differences grow
// to the rounding noise itself; no tight tolerance could stand. Gradients of parameters feed nothing: double.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "redrive/field/nerf_field.h"
#include "redrive/kernels/cpu/bf16/test_support.h"

namespace redrive::kernels::bf16 {

class ReferenceNetwork {
 public:
  ReferenceNetwork(const NerfConfig& config, std::span<const float> parameters, SumOrder order)
      : config_(config), order_(order), exact_(parameters.begin(), parameters.end()) {
    for (const float p : parameters) rounded_.push_back(round_bf16(p));
  }

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
    h = apply(trace, kNerfFeature, h);
    for (float& x : h) x = round_bf16(x);
    h.insert(h.end(), gamma_d.begin(), gamma_d.end());
    h = relu(apply(trace, kNerfColour, h));
    const std::vector<float> rgb = apply(trace, kNerfRgb, h);
    std::copy(rgb.begin(), rgb.end(), trace.raw);
    return trace;
  }

  void backward(const Trace& trace, const float d_raw[4], std::span<double> gradients) const {
    std::vector<float> d(d_raw, d_raw + 3);
    d = masked(adjoint(trace, {kNerfRgb}, d, gradients), trace, kNerfColour);
    d = adjoint(trace, {kNerfColour}, d, gradients);
    d.resize(config_.width);
    d.push_back(d_raw[3]);
    d = adjoint(trace, {kNerfFeature, kNerfDensity}, d, gradients);  // one sum over both layers' outputs
    for (int layer = kNerfHidden - 1; layer >= 0; --layer) {
      d = adjoint(trace, {layer}, masked(d, trace, layer), gradients);
    }
  }

 private:
  /// init + sum a(k) b(k)
  template <class A, class B>
  float dot(float init, int n, const A& a, const B& b) const {
    const auto times = [&](int k, float sum) { return k < n ? std::fma(a(k), b(k), sum) : sum; };
    if (order_ == SumOrder::kPairs) {
      for (int k = 0; k < n; k += 2) init = times(k, times(k + 1, init));
      return init;
    }
    for (int first = 0; first < n; first += 32) {
      float even = 0, odd = 0;
      for (int k = first; k < first + 32; k += 2) {
        even = times(k, even);
        odd = times(k + 1, odd);
      }
      init += even + odd;
    }
    return init;
  }

  std::vector<float> apply(Trace& trace, int layer, const std::vector<float>& input) const {
    const NerfLayerShape shape = nerf_layer(config_, layer);
    trace.input[layer] = input;
    for (int o = 0; o < shape.outputs; ++o) {
      const float* w = &rounded_[shape.weight + static_cast<std::size_t>(o) * shape.inputs];
      trace.output[layer].push_back(dot(
          exact_[shape.bias + o], shape.inputs, [&](int k) { return w[k]; }, [&](int k) { return input[k]; }));
    }
    return trace.output[layer];
  }

  static std::vector<float> relu(std::vector<float> output) {
    for (float& x : output) x = round_bf16(std::max(x, 0.0f));
    return output;
  }

  static std::vector<float> masked(std::vector<float> d, const Trace& trace, int layer) {
    d.resize(trace.output[layer].size());  // behind the skip stands the encoding's part: no further way back
    for (std::size_t i = 0; i < d.size(); ++i) d[i] = trace.output[layer][i] > 0 ? d[i] : 0;
    return d;
  }

  /// d: gradients of the outputs of `layers`, which share their input, one behind the other. Adds the gradients of
  /// their weights and biases; returns that of the input.
  std::vector<float> adjoint(const Trace& trace, const std::vector<int>& layers, const std::vector<float>& d,
                             std::span<double> gradients) const {
    std::vector<float> d_rounded;
    for (const float x : d) d_rounded.push_back(round_bf16(x));
    const std::vector<float>& input = trace.input[layers[0]];
    std::vector<const float*> rows;
    for (const int layer : layers) {
      const NerfLayerShape shape = nerf_layer(config_, layer);
      for (int o = 0; o < shape.outputs; ++o) {
        const std::size_t row = shape.weight + static_cast<std::size_t>(o) * shape.inputs, output = rows.size();
        gradients[shape.bias + o] += d[output];
        for (int k = 0; k < shape.inputs; ++k) gradients[row + k] += static_cast<double>(d_rounded[output]) * input[k];
        rows.push_back(&rounded_[row]);
      }
    }
    std::vector<float> d_input(input.size());
    for (std::size_t i = 0; i < input.size(); ++i) {
      d_input[i] = dot(
          0, static_cast<int>(d.size()), [&](int o) { return d_rounded[o]; }, [&](int o) { return rows[o][i]; });
    }
    return d_input;
  }

  NerfConfig config_;
  SumOrder order_;
  std::vector<float> exact_, rounded_;
};

}  // namespace redrive::kernels::bf16
