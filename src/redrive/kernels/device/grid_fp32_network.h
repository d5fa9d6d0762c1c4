// SPDX-License-Identifier: Apache-2.0
// The networks of field/grid_field.h on a device, forward and backward.
#pragma once

#include <array>
#include <cmath>
#include <utility>

#include "redrive/kernels/device/fp32_layers.h"
#include "redrive/kernels/grid_stages.h"

namespace redrive::kernels {

/// Layout of a batch's features [levels, n, features]: offset of number `c` of a sample.
struct FeatureLayout {
  std::size_t n, features_per_level;

  REDRIVE_HD std::size_t at(std::size_t sample, std::size_t c) const {
    return (c / features_per_level * n + sample) * features_per_level + c % features_per_level;
  }
};

/// Copies number i of the rows of samples first, first + 1, ...
struct GatherFeatures {
  FeatureLayout layout;
  std::size_t outputs, first;
  std::span<const float> features;
  float* rows;

  REDRIVE_HD void operator()(std::size_t i) const {
    rows[i] = features[layout.at(first + i / outputs, i % outputs)];
  }
};
struct ScatterFeatures {
  FeatureLayout layout;
  std::size_t outputs, first;
  const float* rows;
  std::span<float> features;

  REDRIVE_HD void operator()(std::size_t i) const {
    features[layout.at(first + i / outputs, i % outputs)] = rows[i];
  }
};

/// Copies its ray's harmonics to each sample.
struct BroadcastHarmonics {
  std::size_t per_ray, first;
  std::span<const float> harmonics;
  SampleMatrix<float> rows;

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::size_t sample = i / kHarmonics, c = i % kHarmonics;
    rows.at(sample, c) = harmonics[(first + sample) / per_ray * kHarmonics + c];
  }
};

REDRIVE_HD inline float grid_density(float density_scale, float log_density) {
  const float most = kMaxLogDensity;
  return density_scale * std::exp(log_density > most ? most : log_density);
}

struct DensityActivation {
  float density_scale;
  SampleMatrix<float> geometry, density;

  REDRIVE_HD void operator()(std::size_t sample) const {
    density.at(sample, 0) = grid_density(density_scale, geometry.at(sample, 0));
  }
};
struct DensityActivationBackward {
  float density_scale;
  SampleMatrix<float> geometry;
  SampleMatrix<const float> d_density;
  SampleMatrix<float> d_geometry;

  REDRIVE_HD void operator()(std::size_t sample) const {
    d_geometry.at(sample, 0) +=
        d_density.at(sample, 0) * grid_density(density_scale, geometry.at(sample, 0));
  }
};

inline LayerLayout grid_layer_layout(const GridFieldConfig& config, int layer) {
  const GridLayerShape shape = grid_layer(config, layer);
  return {static_cast<std::size_t>(shape.outputs), static_cast<std::size_t>(shape.inputs),
          shape.offset, false, layer != kGridDensity1 && layer != kGridColourOut};
}

template <class Device>
class GridFp32Network {
 public:
  /// Runs on at most `most` samples at once of n = n_rays * per_ray. features, harmonics: as the
  /// stage has them, on the device. Empty gradients: forward only.
  GridFp32Network(Stage<Device>& stage, const GridNetwork& network, std::size_t n,
                  std::size_t per_ray, std::size_t most, std::span<const float> features,
                  std::span<const float> harmonics, std::span<float> gradients)
      : stage_(stage),
        network_(network),
        per_ray_(per_ray),
        features_(features),
        harmonics_(harmonics),
        places_{n, static_cast<std::size_t>(network.config.grid.features_per_level)},
        layers_(stage, network.weights, gradients),
        last_(network.config.colour_layers == 2 ? kGridColour1 : kGridColour0) {
    for (int l = 0; l < kGridLayers; ++l) {
      place_[l] = grid_layer_layout(network.config, l);
      input_[l] = l == kGridColourOut && last_ == kGridColour0
                      ? input_[kGridColour1]  // this layer does not exist
                      : layers_.rows(most, place_[l].inputs);
    }
    if (gradients.empty()) return;
    for (SampleMatrix<float>& d : d_)
      d = layers_.rows(most, std::max(network.config.width, network.config.grid.outputs()));
    layers_.reserve_slices(most, place_);
  }

  /// Keeps the inputs of all layers. Writes raw (4 numbers per sample) unless it is empty.
  void forward(std::size_t first, std::size_t count, SampleMatrix<float> raw) {
    const std::size_t outputs = network_.config.grid.outputs();
    const SampleMatrix<float> geometry = input_[kGridColour0];
    stage_.for_each(count * outputs,
                    GatherFeatures{places_, outputs, first, features_, input_[kGridDensity0].data});
    stage_.for_each(
        count * kHarmonics,
        BroadcastHarmonics{
            per_ray_, first, harmonics_, {geometry.data + kGeometryFeatures, geometry.sample}});
    for (int l = kGridDensity0; l <= last_; ++l)
      layers_.forward(place_[l], count, input_[l], input_[l + 1]);
    if (!raw.data) return;
    layers_.forward(place_[kGridColourOut], count, input_[kGridColourOut], raw);
    stage_.for_each(count, DensityActivation{network_.density_scale,
                                             geometry,
                                             {raw.data + 3 * raw.number, raw.sample, raw.number}});
  }

  /// Backward pass of the samples of the last call of forward, with the same `first`. Writes their
  /// d_features on the device.
  void backward(std::size_t first, std::size_t count, SampleMatrix<const float> d_raw,
                std::span<float> d_features) {
    const std::size_t width = network_.config.width, outputs = network_.config.grid.outputs();
    SampleMatrix<float> d = d_[0], next = d_[1];
    layers_.backward_weights(place_[kGridColourOut], count, input_[kGridColourOut], d_raw);
    layers_.backward_inputs(place_[kGridColourOut], count, d_raw, d, width, input_[kGridColourOut]);
    const auto back = [&](int l, std::size_t columns, SampleMatrix<float> opened) {
      layers_.backward_weights(place_[l], count, input_[l], read_only(d));
      layers_.backward_inputs(place_[l], count, read_only(d), next, columns, opened);
      std::swap(d, next);
    };
    if (last_ == kGridColour1) back(kGridColour1, width, input_[kGridColour1]);
    back(kGridColour0, kGeometryFeatures, {});
    stage_.for_each(count, DensityActivationBackward{
                               network_.density_scale,
                               input_[kGridColour0],
                               {d_raw.data + 3 * d_raw.number, d_raw.sample, d_raw.number},
                               d});
    back(kGridDensity1, width, input_[kGridDensity1]);
    layers_.backward_weights(place_[kGridDensity0], count, input_[kGridDensity0], read_only(d));
    next.sample = outputs;  // without gaps
    layers_.backward_inputs(place_[kGridDensity0], count, read_only(d), next, outputs);
    stage_.for_each(count * outputs,
                    ScatterFeatures{places_, outputs, first, next.data, d_features});
  }

 private:
  Stage<Device>& stage_;
  GridNetwork network_;  // with weights on the device
  std::size_t per_ray_;
  std::span<const float> features_, harmonics_;
  FeatureLayout places_;
  Fp32Layers<Device> layers_;
  int last_;  // last hidden colour layer
  std::array<LayerLayout, kGridLayers> place_;
  std::array<SampleMatrix<float>, kGridLayers> input_;
  SampleMatrix<float> d_[2];
};

}  // namespace redrive::kernels
