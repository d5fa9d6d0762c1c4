// SPDX-License-Identifier: Apache-2.0
// Layers on tensor cores: memory of their activations, and the functors of tensor_tiles.h and
// tensor_product.h on a device.
#pragma once

#include "redrive/kernels/device/fp32_layers.h"
#include "redrive/kernels/device/tensor_tiles.h"

namespace redrive::kernels {

/// Packs the weights of many layers at once.
template <class Device, int kMost>
class TensorWeightPacker {
 public:
  explicit TensorWeightPacker(Stage<Device>& stage) : stage_(stage) {}

  /// Returns the address of the packed weights. All of their tiles of k belong to this layer.
  const LanePair* add(PackTensorWeights layer) {
    layer.tiles_of_k = layer.own_tiles_of_k();
    return add_to(stage_.template scratch<LanePair>(layer.words() / 2).data(), layer);
  }
  const LanePair* add_to(LanePair* to, PackTensorWeights layer) {
    layer.to = to;
    layers_.add(layer, layer.words());
    return to;
  }
  void run() { stage_.for_each(layers_.size(), layers_); }

 private:
  Stage<Device>& stage_;
  ConcatenatedFunctors<PackTensorWeights, kMost> layers_;
};

/// Allocates `columns` numbers for each of `samples` samples, in the requested forms.
template <class Device>
TensorActivations tensor_activations(Stage<Device>& stage, std::size_t samples, std::size_t columns,
                                     bool as_rows, bool as_columns) {
  TensorActivations out{nullptr, nullptr, tensor_tiles(samples), tensor_tiles(columns)};
  const std::size_t words = out.sample_tiles * out.column_tiles * kLanes;
  if (as_rows) out.rows = stage.template scratch<LaneWords>(words).data();
  if (as_columns) out.columns = stage.template scratch<LaneWords>(words).data();
  return out;
}

/// `gradients` (may be empty) are on the device and are added to.
template <class Device>
class TensorLayers {
 public:
  TensorLayers(Stage<Device>& stage, std::span<float> gradients)
      : stage_(stage), gradients_(gradients.data()) {}

  /// Allocates the partial sums of backward_weights for any of these layers and this many samples.
  void reserve_slices(std::size_t samples, std::span<const LayerLayout> layers) {
    std::size_t largest = 0;
    for (const LayerLayout& layer : layers) largest = std::max(largest, layer.size());
    partial_ = stage_.template scratch<float>(slices_of(samples) * largest);
  }

  /// Uses the columns of x and d_y; first_d_y is the tile of the layer's first output. d_y:
  /// derivatives before the layer's ReLU.
  void backward_weights(const LayerLayout& layer, std::size_t samples, const TensorActivations& x,
                        const TensorActivations& d_y, std::size_t first_d_y = 0) {
    const TensorWeightBackward backward{.samples = samples,
                                        .outputs = layer.outputs,
                                        .inputs = layer.inputs,
                                        .has_bias = layer.has_bias,
                                        .d_y = d_y,
                                        .first_d_y = first_d_y,
                                        .x = x,
                                        .partial = partial_.data(),
                                        .row = layer.size()};
    stage_.for_each_warp(backward.warps(), backward);
    reduce_slices(stage_, slices_of(samples), layer.size(), partial_.data(),
                  gradients_ + layer.offset);
  }

 private:
  Stage<Device>& stage_;
  float* gradients_;
  std::span<float> partial_;
};

}  // namespace redrive::kernels
