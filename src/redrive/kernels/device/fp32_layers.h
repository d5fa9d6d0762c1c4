// SPDX-License-Identifier: Apache-2.0
// Layers of a network (fp32_layer_functors.h) in sequence, on as many samples as their activations
// are kept for.
#pragma once

#include "redrive/kernels/device/fp32_layer_functors.h"
#include "redrive/kernels/device/stage.h"

namespace redrive::kernels {

/// A layer in the flat buffer of all parameters: weight [outputs, inputs] at `offset`, followed by
/// its bias [outputs].
struct LayerLayout {
  std::size_t outputs, inputs, offset;
  bool has_bias, has_relu;

  std::size_t size() const { return outputs * (inputs + (has_bias ? 1 : 0)); }
};

/// gradients [size] += partial [slices, size], in an order that `slices` alone determines.
/// Overwrites `partial`. Many slices are added up in groups first, since a thread that adds
/// hundreds of numbers waits for memory hundreds of times.
template <class Device>
void reduce_slices(Stage<Device>& stage, std::size_t slices, std::size_t size, float* partial,
                   float* gradients) {
  if (slices > kSlicesPerGroup) {
    const ReduceSliceGroups groups{slices, size, partial};
    stage.for_each(groups.groups() * size, groups);
  }
  stage.for_each(size, ReduceSlices{slices, size, partial, gradients,
                                    slices > kSlicesPerGroup ? kSlicesPerGroup : 1});
}

/// `parameters` and `gradients` (may be empty) are on the device; gradients are added to.
template <class Device>
class Fp32Layers {
 public:
  Fp32Layers(Stage<Device>& stage, std::span<const float> parameters, std::span<float> gradients)
      : stage_(stage), parameters_(parameters.data()), gradients_(gradients.data()) {}

  /// Allocates `columns` numbers for each of `samples` samples.
  SampleMatrix<float> rows(std::size_t samples, std::size_t columns) {
    return {stage_.template scratch<float>(samples * columns).data(), columns};
  }
  /// Allocates the partial sums of backward_weights for any of these layers and this many samples.
  void reserve_slices(std::size_t samples, std::span<const LayerLayout> layers) {
    std::size_t largest = 0;
    for (const LayerLayout& layer : layers) largest = std::max(largest, layer.size());
    partial_ = stage_.template scratch<float>(slices_of(samples) * largest);
  }

  void forward(const LayerLayout& layer, std::size_t samples, SampleMatrix<float> x,
               SampleMatrix<float> y) {
    const float* const weight = parameters_ + layer.offset;
    run(LayerForward{.samples = samples,
                     .outputs = layer.outputs,
                     .inputs = layer.inputs,
                     .weight = weight,
                     .bias = layer.has_bias ? weight + layer.outputs * layer.inputs : nullptr,
                     .has_relu = layer.has_relu,
                     .x = read_only(x),
                     .y = y});
  }

  /// Computes d_x for `columns` of the layer's inputs from `first` on. `opened`: these inputs
  /// themselves if they are the output of a ReLU.
  void backward_inputs(const LayerLayout& layer, std::size_t samples, SampleMatrix<const float> d_y,
                       SampleMatrix<float> d_x, std::size_t columns,
                       SampleMatrix<float> opened = {}, bool adds = false, std::size_t first = 0) {
    run(LayerInputBackward{.samples = samples,
                           .outputs = layer.outputs,
                           .inputs = layer.inputs,
                           .columns = columns,
                           .weight = parameters_ + layer.offset + first,
                           .adds = adds,
                           .d_y = d_y,
                           .opened = read_only(opened),
                           .d_x = d_x});
  }

  /// d_y: derivatives before the layer's ReLU, if it has one; 0 where it is closed.
  void backward_weights(const LayerLayout& layer, std::size_t samples, SampleMatrix<float> x,
                        SampleMatrix<const float> d_y) {
    run(LayerWeightBackward{.samples = samples,
                            .outputs = layer.outputs,
                            .inputs = layer.inputs,
                            .has_bias = layer.has_bias,
                            .d_y = d_y,
                            .x = read_only(x),
                            .partial = partial_.data()});
    reduce_slices(stage_, slices_of(samples), layer.size(), partial_.data(),
                  gradients_ + layer.offset);
  }

 private:
  template <class Tiles>
  void run(const Tiles& layer) {
    stage_.for_each(layer.tiles(), layer);
  }

  Stage<Device>& stage_;
  const float* parameters_;
  float* gradients_;
  std::span<float> partial_;
};

}  // namespace redrive::kernels
