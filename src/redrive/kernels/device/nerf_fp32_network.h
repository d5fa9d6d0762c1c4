// SPDX-License-Identifier: Apache-2.0
// The network of field/nerf_field.h on a device: encoding and layers, forward and backward.
#pragma once

#include <array>
#include <cmath>
#include <utility>

#include "redrive/field/positional_encoding.h"
#include "redrive/kernels/device/fp32_layers.h"
#include "redrive/kernels/nerf_stages.h"

namespace redrive::kernels {

/// Positional encoding gamma (field/positional_encoding.h) of a point in float. Whole turns are
/// subtracted from the angles in double, so that none rounds by more than pi 2^-24.
REDRIVE_HD inline void encode_point(const double point[3], int octaves, float* out) {
  for (int d = 0; d < 3; ++d) {
    out[d] = static_cast<float>(point[d]);
    for (int l = 0; l < octaves; ++l) {
      const double turns = point[d] * 0.5 * static_cast<double>(1 << l);
      const float angle = static_cast<float>(6.283185307179586 * (turns - std::floor(turns + 0.5)));
      out[3 + 2 * (d * octaves + l)] = std::sin(angle);
      out[3 + 2 * (d * octaves + l) + 1] = std::cos(angle);
    }
  }
}

/// Encodes samples first, first + 1, ... of a batch: the position for the first layer, a second
/// copy for the skip unless empty, and the direction.
struct EncodeSamples {
  NerfConfig config;
  UnitFromWorld unit_from_world;
  Rays rays;
  Samples samples;
  std::size_t first;
  SampleMatrix<float> position, position_again, direction;

  REDRIVE_HD void operator()(std::size_t i) const {
    const std::size_t sample = first + i, ray = sample / samples.per_ray, n = rays.n;
    double x[3], towards[3];
    for (int k = 0; k < 3; ++k) {
      towards[k] = rays.direction[k * n + ray];
      x[k] =
          (rays.origin[k * n + ray] + samples.t[sample] * towards[k] - unit_from_world.center[k]) *
          unit_from_world.scale;
    }
    float* const gamma = &position.at(i, 0);
    encode_point(x, config.position_octaves, gamma);
    if (position_again.data)
      for (int c = 0; c < encoded_size(config.position_octaves); ++c)
        position_again.at(i, c) = gamma[c];
    encode_point(towards, config.direction_octaves, &direction.at(i, 0));
  }
};

/// Computes a position's derivative from gamma of the position and its derivative.
struct EncodeSamplesBackward {
  int octaves;
  SampleMatrix<float> gamma, d_gamma, d_position;

  REDRIVE_HD void operator()(std::size_t i) const {
    float d[3];
    positional_encoding_adjoint(&gamma.at(i, 0), octaves, &d_gamma.at(i, 0), d);
    for (int k = 0; k < 3; ++k) d_position.at(i, k) = d[k];
  }
};

inline LayerLayout nerf_layer_layout(const NerfConfig& config, int layer) {
  const NerfLayerShape shape = nerf_layer(config, layer);
  return {static_cast<std::size_t>(shape.outputs), static_cast<std::size_t>(shape.inputs),
          shape.weight, true, layer < kNerfHidden || layer == kNerfColour};
}

template <class Device>
class NerfFp32Network {
 public:
  /// Runs on at most `most` samples at once. Empty gradients: forward only. of_positions: whether
  /// backward writes the positions' derivatives.
  NerfFp32Network(Stage<Device>& stage, const NerfField& field, std::size_t most,
                  std::span<float> gradients, bool of_positions)
      : stage_(stage), field_(field), layers_(stage, field.parameters, gradients) {
    const std::size_t width = field.config.width;
    for (int l = 0; l < kNerfLayers; ++l) {
      place_[l] = nerf_layer_layout(field.config, l);
      input_[l] = l == kNerfFeature ? input_[kNerfDensity] : layers_.rows(most, place_[l].inputs);
    }
    if (gradients.empty()) return;
    for (SampleMatrix<float>& d : d_) d = layers_.rows(most, width);
    layers_.reserve_slices(most, place_);
    if (of_positions) d_gamma_ = layers_.rows(most, encoded_size(field.config.position_octaves));
  }

  /// Keeps the inputs of all layers. Writes raw (4 numbers per sample) unless it is empty.
  void forward(const Rays& rays, const Samples& samples, std::size_t first, std::size_t count,
               SampleMatrix<float> raw) {
    const std::size_t width = field_.config.width;
    stage_.for_each(
        count, EncodeSamples{field_.config, field_.unit_from_world, rays, samples, first, input_[0],
                             from(input_[kNerfSkip], width), from(input_[kNerfColour], width)});
    for (int l = 0; l < kNerfHidden; ++l)
      layers_.forward(place_[l], count, input_[l], input_[l + 1]);
    layers_.forward(place_[kNerfFeature], count, input_[kNerfFeature], input_[kNerfColour]);
    layers_.forward(place_[kNerfColour], count, input_[kNerfColour], input_[kNerfRgb]);
    if (!raw.data) return;
    layers_.forward(place_[kNerfDensity], count, input_[kNerfDensity], from(raw, 3));
    layers_.forward(place_[kNerfRgb], count, input_[kNerfRgb], raw);
  }

  /// Backward pass of the samples of the last call of forward. Writes d_position (3 numbers per
  /// sample) if of_positions.
  void backward(std::size_t count, SampleMatrix<const float> d_raw,
                SampleMatrix<float> d_position) {
    const std::size_t gamma = encoded_size(field_.config.position_octaves);
    const std::size_t width = field_.config.width;
    const SampleMatrix<const float> d_density{d_raw.data + 3 * d_raw.number, d_raw.sample,
                                              d_raw.number};
    SampleMatrix<float> d = d_[0], next = d_[1];
    layers_.backward_weights(place_[kNerfRgb], count, input_[kNerfRgb], d_raw);
    layers_.backward_inputs(place_[kNerfRgb], count, d_raw, d, width / 2, input_[kNerfRgb]);
    const auto back = [&](int l, SampleMatrix<float> opened) {
      layers_.backward_weights(place_[l], count, input_[l], read_only(d));
      layers_.backward_inputs(place_[l], count, read_only(d), next, width, opened);
      std::swap(d, next);
    };
    back(kNerfColour, {});
    layers_.backward_weights(place_[kNerfFeature], count, input_[kNerfFeature], read_only(d));
    layers_.backward_inputs(place_[kNerfFeature], count, read_only(d), next, width);
    layers_.backward_weights(place_[kNerfDensity], count, input_[kNerfDensity], d_density);
    layers_.backward_inputs(place_[kNerfDensity], count, d_density, next, width,
                            input_[kNerfDensity],
                            /*adds=*/true);
    std::swap(d, next);
    for (int l = kNerfHidden - 1; l > 0; --l) {
      if (l == kNerfSkip && d_gamma_.data)
        layers_.backward_inputs(place_[l], count, read_only(d), d_gamma_, gamma, {}, /*adds=*/false,
                                /*first=*/width);
      back(l, input_[l]);
    }
    layers_.backward_weights(place_[0], count, input_[0], read_only(d));
    if (!d_gamma_.data) return;
    layers_.backward_inputs(place_[0], count, read_only(d), d_gamma_, gamma, {}, /*adds=*/true);
    stage_.for_each(count, EncodeSamplesBackward{field_.config.position_octaves, input_[0],
                                                 d_gamma_, d_position});
  }

 private:
  static SampleMatrix<float> from(SampleMatrix<float> all, std::size_t column) {
    return {all.data + column * all.number, all.sample, all.number};
  }

  Stage<Device>& stage_;
  NerfField field_;  // with parameters on the device
  Fp32Layers<Device> layers_;
  std::array<LayerLayout, kNerfLayers> place_;
  std::array<SampleMatrix<float>, kNerfLayers> input_;
  SampleMatrix<float> d_[2], d_gamma_;
};

}  // namespace redrive::kernels
