// SPDX-License-Identifier: Apache-2.0
// Layers on tensor cores: memory for their weights and for what goes between them.
#pragma once

#include "redrive/kernels/cuda/network_layers.h"
#include "redrive/kernels/cuda/tensor_tiles.h"

namespace redrive::kernels {

/// Packs many layers' weights at once.
template <class Device, int kMost>
class TensorWeightPacker {
 public:
  explicit TensorWeightPacker(Stage<Device>& stage) : stage_(stage) {}

  /// Where they will be; all of their tiles of k are this layer's.
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
  InTurn<PackTensorWeights, kMost> layers_;
};

/// Room for `columns` numbers of each of so many samples, in the forms that are asked for.
template <class Device>
TensorActivations tensor_activations(Stage<Device>& stage, std::size_t samples, std::size_t columns, bool as_rows,
                                     bool as_columns) {
  TensorActivations out{nullptr, nullptr, tensor_tiles(samples), tensor_tiles(columns)};
  const std::size_t words = out.sample_tiles * out.column_tiles * kLanes;
  if (as_rows) out.rows = stage.template scratch<LaneWords>(words).data();
  if (as_columns) out.columns = stage.template scratch<LaneWords>(words).data();
  return out;
}

}  // namespace redrive::kernels
