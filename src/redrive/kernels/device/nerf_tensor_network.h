// SPDX-License-Identifier: Apache-2.0
// The network of field/nerf_field.h on tensor cores: layer by layer as NerfFp32Network, with
// activations and derivatives in bf16.
#pragma once

#include <array>
#include <utility>

#include "redrive/kernels/device/nerf_fp32_network.h"
#include "redrive/kernels/device/tensor_layers.h"
#include "redrive/kernels/device/tensor_product.h"

namespace redrive::kernels {

template <class Device>
class NerfTensorNetwork {
 public:
  /// Arguments as in NerfFp32Network.
  NerfTensorNetwork(Stage<Device>& stage, const NerfField& field, std::size_t most,
                    std::span<float> gradients, bool of_positions)
      : stage_(stage), field_(field), layers_(stage, gradients), trains_(!gradients.empty()) {
    const std::size_t width = field.config.width;
    TensorWeightPacker<Device, 2 * kNerfLayers + 2> pack(stage);
    for (int l = 0; l < kNerfLayers; ++l) {
      place_[l] = nerf_layer_layout(field.config, l);
      input_[l] = l == kNerfFeature ? input_[kNerfDensity] : activations(most, place_[l].inputs);
      forward_[l] = pack.add(weights(l, false, 0, place_[l].inputs));
    }
    gamma_ = numbers(most, place_[0].inputs);
    direction_ = numbers(most, encoded_size(field.config.direction_octaves));
    if (trains_) {
      for (int l = 1; l < kNerfLayers; ++l)
        if (l != kNerfDensity && l != kNerfFeature)
          back_[l] = pack.add(weights(l, true, 0, std::min(width, place_[l].inputs)));
      add_heads(&pack);
    }
    if (of_positions) {
      back_[0] = pack.add(weights(0, true, 0, place_[0].inputs));
      back_skip_ = pack.add(weights(kNerfSkip, true, width, place_[0].inputs));
      d_gamma_ = numbers(most, place_[0].inputs);
    }
    pack.run();
    if (!trains_) return;
    d_rgb_ = activations(most, 3);
    d_colour_ = activations(most, width / 2);
    d_heads_ = activations(most, width + 1);
    for (TensorActivations& d : d_) d = activations(most, width);
    layers_.reserve_slices(most, place_);
  }

  /// Keeps the inputs of all layers. Writes raw (4 numbers per sample) unless it is empty.
  void forward(const Rays& rays, const Samples& samples, std::size_t first, std::size_t count,
               SampleMatrix<float> raw) {
    const std::size_t behind = tensor_tiles(field_.config.width);
    stage_.for_each(
        count,
        EncodeSamples{
            field_.config, field_.unit_from_world, rays, samples, first, gamma_, {}, direction_});
    put(count, place_[0].inputs, read_only(gamma_), input_[0], 0);
    put(count, place_[0].inputs, read_only(gamma_), input_[kNerfSkip], behind);
    put(count, encoded_size(field_.config.direction_octaves), read_only(direction_),
        input_[kNerfColour], behind);
    for (int l = 0; l < kNerfHidden; ++l) layer(l, count, input_[l + 1], {});
    layer(kNerfFeature, count, input_[kNerfColour], {});
    layer(kNerfColour, count, input_[kNerfRgb], {});
    if (!raw.data) return;
    layer(kNerfDensity, count, {}, {raw.data + 3 * raw.number, raw.sample, raw.number});
    layer(kNerfRgb, count, {}, raw);
  }

  /// Backward pass of the samples of the last call of forward. Writes d_position (3 numbers per
  /// sample) if requested.
  void backward(std::size_t count, SampleMatrix<const float> d_raw,
                SampleMatrix<float> d_position) {
    const std::size_t width = field_.config.width, heads = tensor_tiles(width),
                      gamma = place_[0].inputs;
    put(count, 3, d_raw, d_rgb_, 0);
    put(count, 1, {d_raw.data + 3 * d_raw.number, d_raw.sample, d_raw.number}, d_heads_, heads);
    layers_.backward_weights(place_[kNerfRgb], count, input_[kNerfRgb], d_rgb_);
    back(kNerfRgb, count, width / 2, d_rgb_, d_colour_, input_[kNerfRgb]);
    layers_.backward_weights(place_[kNerfColour], count, input_[kNerfColour], d_colour_);
    back(kNerfColour, count, width, d_colour_, d_heads_, {});
    layers_.backward_weights(place_[kNerfFeature], count, input_[kNerfFeature], d_heads_);
    layers_.backward_weights(place_[kNerfDensity], count, input_[kNerfDensity], d_heads_, heads);
    TensorActivations d = d_[0], next = d_[1];
    back(kNerfFeature, count, width, d_heads_, d, input_[kNerfFeature]);
    for (int l = kNerfHidden - 1; l > 0; --l) {
      layers_.backward_weights(place_[l], count, input_[l], d);
      if (l == kNerfSkip && d_gamma_.data) run(product(count, gamma, d, back_skip_, d_gamma_));
      back(l, count, width, d, next, input_[l]);
      std::swap(d, next);
    }
    layers_.backward_weights(place_[0], count, input_[0], d);
    if (!d_gamma_.data) return;
    auto of_first = product(count, gamma, d, back_[0], d_gamma_);
    of_first.adds = true;
    run(of_first);
    stage_.for_each(
        count, EncodeSamplesBackward{field_.config.position_octaves, gamma_, d_gamma_, d_position});
  }

 private:
  /// Allocates both forms, or rows only where there is no backward pass.
  TensorActivations activations(std::size_t samples, std::size_t columns) {
    return tensor_activations(stage_, samples, columns, true, trains_);
  }
  SampleMatrix<float> numbers(std::size_t samples, std::size_t columns) {
    return {stage_.template scratch<float>(samples * columns).data(), columns};
  }

  /// Packs inputs [first, first + inputs) of a layer.
  PackTensorWeights weights(int l, bool back, std::size_t first, std::size_t inputs) const {
    return {.weight = field_.parameters.data() + place_[l].offset + first,
            .outputs = place_[l].outputs,
            .inputs = inputs,
            .row = place_[l].inputs,
            .back = back};
  }
  /// Feature and density have the same inputs, whose derivatives are one sum over the outputs of
  /// both layers.
  template <class Packer>
  void add_heads(Packer* pack) {
    PackTensorWeights feature = weights(kNerfFeature, true, 0, place_[kNerfFeature].inputs),
                      density = weights(kNerfDensity, true, 0, place_[kNerfDensity].inputs);
    density.first_k = feature.own_tiles_of_k();
    feature.tiles_of_k = density.tiles_of_k = density.first_k + density.own_tiles_of_k();
    LanePair* const to =
        stage_.template scratch<LanePair>((feature.words() + density.words()) / 2).data();
    back_[kNerfFeature] = pack->add_to(to, feature);
    pack->add_to(to, density);
  }

  void put(std::size_t count, std::size_t columns, SampleMatrix<const float> from,
           const TensorActivations& to, std::size_t first_to) {
    const PackTensorActivations tiles{count, columns, from, to, first_to};
    stage_.for_each_warp(tiles.warps(), tiles);
  }

  TensorProduct product(std::size_t count, std::size_t columns, const TensorActivations& x,
                        const LanePair* weights, SampleMatrix<float> out) const {
    return {.samples = count,
            .columns = columns,
            .tiles_of_k = x.column_tiles,
            .x = x,
            .weights = weights,
            .numbers = out};
  }
  void run(const TensorProduct& product) { stage_.for_each_warp(product.warps(), product); }

  void layer(int l, std::size_t count, const TensorActivations& y, SampleMatrix<float> out) {
    TensorProduct forward = product(count, place_[l].outputs, input_[l], forward_[l], out);
    forward.bias =
        field_.parameters.data() + place_[l].offset + place_[l].outputs * place_[l].inputs;
    forward.has_relu = place_[l].has_relu;
    forward.y = y;
    run(forward);
  }
  void back(int l, std::size_t count, std::size_t columns, const TensorActivations& d_y,
            const TensorActivations& d_x, const TensorActivations& opened) {
    TensorProduct backward = product(count, columns, d_y, back_[l], {});
    backward.opened = opened;
    backward.y = d_x;
    run(backward);
  }

  Stage<Device>& stage_;
  NerfField field_;  // with parameters on the device
  TensorLayers<Device> layers_;
  bool trains_;
  std::array<LayerLayout, kNerfLayers> place_;
  std::array<TensorActivations, kNerfLayers> input_;
  std::array<const LanePair*, kNerfLayers> forward_{},
      back_{};                           // back_[kNerfFeature]: followed by density
  const LanePair* back_skip_ = nullptr;  // for gamma(x) at the skip
  TensorActivations d_rgb_, d_colour_, d_heads_, d_[2];
  SampleMatrix<float> gamma_, direction_, d_gamma_;
};

}  // namespace redrive::kernels
