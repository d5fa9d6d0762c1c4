// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/cpu/fp32/fp32_network.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/kernels/cpu/fp32/fp32_lane.h"

namespace redrive::kernels {
namespace {

int round_up(int n, int multiple) { return (n + multiple - 1) / multiple * multiple; }

/// The field's layer (field/nerf_field.h) of one of the computation; colour stands for feature and colour.
int field_layer(int layer) {
  switch (layer) {
    case kFp32Colour: return kNerfColour;
    case kFp32Density: return kNerfDensity;
    case kFp32Rgb: return kNerfRgb;
    default: return layer;
  }
}

/// packed[o / rows][k][o % rows] = at(o, k).
template <class At>
void pack_rows(int outputs, int inputs, int rows, float* packed, At at) {
  for (int o = 0; o < outputs; o += rows)
    for (int k = 0; k < inputs; ++k)
      for (int r = 0; r < rows; ++r) *packed++ = at(o + r, k);
}

}  // namespace

Fp32Network::Fp32Network(const NerfConfig& config, const Fp32Kernels& kernels)
    : config_(config),
      kernels_(kernels),
      position_rows_(round_up(encoded_size(config.position_octaves), kernels.lanes)),
      direction_rows_(round_up(encoded_size(config.direction_octaves), kernels.lanes)) {
  const int width = config.width, rows = kernels.rows;
  REDRIVE_CHECK(width % 32 == 0 && width >= 32);
  for (int l = 0; l < kFp32Layers; ++l) {
    PackedLayer& layer = layers_[l];
    layer.k1 = l == 0 ? position_rows_ : l == kFp32Rgb ? width / 2 : width;
    layer.k2 = l == kNerfSkip ? position_rows_ : l == kFp32Colour ? direction_rows_ : 0;
    layer.outputs = l < kNerfHidden    ? width
                    : l == kFp32Colour ? width / 2
                                       : rows;  // rgb and density: one block of rows
    const std::size_t size = static_cast<std::size_t>(layer.outputs) * (layer.k1 + layer.k2);
    layer.plain = Buffer<float>(size);
    layer.forward = Buffer<float>(size);
    layer.bias = Buffer<float>(layer.outputs);
    layer.gradient = gradient_size_;
    gradient_size_ += size;
    layer.bias_gradient = gradient_size_;
    gradient_size_ += static_cast<std::size_t>(layer.outputs) * kernels.lanes;
  }
  for (int l = 1; l < kNerfHidden; ++l) backward_[l] = Buffer<float>(static_cast<std::size_t>(width) * width);
  backward_[kFp32Colour] = Buffer<float>(static_cast<std::size_t>(width) * (width / 2 + rows));
  backward_[kFp32Rgb] = Buffer<float>(static_cast<std::size_t>(width / 2) * rows);
  feature_ = Buffer<float>(static_cast<std::size_t>(width) * width);
  feature_transposed_ = Buffer<float>(feature_.size());
  feature_bias_ = Buffer<float>(width);
  colour_ = Buffer<float>(feature_.size() / 2);
}

// 192 samples: two rays of 96 or four of 48; their activations (11 KB each at width 256) stay in the cache between forward and
// backward, and the weights, read once a layer and tile, are 192 multiply-adds an element.
int Fp32Network::tile_samples() const { return 192; }

void Fp32Network::multiply_rows(MatrixProduct product, ThreadPool& pool) const {
  const int rows = kernels_.rows;
  pool.run_ranges(product.rows / rows, 4, [&](std::size_t begin, std::size_t end) {
    MatrixProduct part = product;
    part.a += static_cast<std::ptrdiff_t>(begin) * rows * product.a_row;
    part.out += static_cast<std::ptrdiff_t>(begin) * rows * product.out_stride;
    part.rows = static_cast<int>(end - begin) * rows;
    kernels_.matrix_product(part);
  });
}

void Fp32Network::pack(std::span<const float> parameters, ThreadPool& pool) {
  REDRIVE_CHECK_OP(parameters.size(), ==, nerf_parameter_count(config_));
  const int width = config_.width, rows = kernels_.rows;
  const float* p = parameters.data();
  const NerfLayerShape feature = nerf_layer(config_, kNerfFeature), colour = nerf_layer(config_, kNerfColour);

  // The factors of the folded layer; see the header.
  std::copy_n(p + feature.weight, feature_.size(), feature_.data());
  std::copy_n(p + feature.bias, width, feature_bias_.data());
  for (int o = 0; o < width / 2; ++o)
    std::copy_n(p + colour.weight + static_cast<std::size_t>(o) * colour.inputs, width,
                colour_.data() + static_cast<std::size_t>(o) * width);
  pool.run_ranges(width, 32, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      for (int k = 0; k < width; ++k)
        feature_transposed_[i * width + k] = feature_[static_cast<std::size_t>(k) * width + i];
  });

  pool.run(kFp32Layers, [&](int l) {
    PackedLayer& layer = layers_[l];
    const int inputs = layer.k1 + layer.k2;
    const NerfLayerShape shape = nerf_layer(config_, field_layer(l));
    // The padding stands behind the last inputs and outputs and stays 0 from the construction.
    for (int o = 0; o < shape.outputs; ++o) {
      std::copy_n(p + shape.weight + static_cast<std::size_t>(o) * shape.inputs, shape.inputs,
                  layer.plain.data() + static_cast<std::size_t>(o) * inputs);
      layer.bias[o] = p[shape.bias + o];
    }
    if (l == kFp32Colour)
      for (int o = 0; o < layer.outputs; ++o) {
        float* row = layer.plain.data() + static_cast<std::size_t>(o) * inputs;
        for (int k = 0; k < width; ++k) layer.bias[o] += row[k] * feature_bias_[k];
        std::fill_n(row, width, 0.0f);
      }
  });
  MatrixProduct fold;
  fold.a = colour_.data(), fold.a_row = width, fold.a_step = 1;
  fold.b = feature_.data(), fold.b_step = width;
  fold.rows = width / 2, fold.columns = width, fold.steps = width;
  fold.out = layers_[kFp32Colour].plain.data(), fold.out_stride = width + direction_rows_;
  multiply_rows(fold, pool);

  pool.run(kFp32Layers, [&](int l) {
    PackedLayer& layer = layers_[l];
    const int inputs = layer.k1 + layer.k2;
    const float* plain = layer.plain.data();
    pack_rows(layer.outputs, inputs, rows, layer.forward.data(),
              [&](int o, int k) { return plain[static_cast<std::size_t>(o) * inputs + k]; });
    if (l == 0 || l == kFp32Density) return;
    const float* density = layers_[kFp32Density].plain.data();
    const int d_outputs = l == kFp32Colour ? layer.outputs + rows : layer.outputs;
    pack_rows(layer.k1, d_outputs, rows, backward_[l].data(), [&](int k, int o) {
      return o < layer.outputs ? plain[static_cast<std::size_t>(o) * inputs + k]
                               : density[static_cast<std::size_t>(o - layer.outputs) * width + k];
    });
  });
}

std::unique_ptr<NerfLane> Fp32Network::make_lane(int max_samples) {
  return std::make_unique<Fp32Lane>(*this, max_samples);
}

void Fp32Network::reduce(std::span<const std::unique_ptr<NerfLane>> lanes, std::span<float> gradients,
                         ThreadPool& pool) {
  REDRIVE_CHECK_OP(gradients.size(), ==, nerf_parameter_count(config_));
  const int width = config_.width, vector = kernels_.lanes;
  // All lanes into the first, in their order; its buffer is then the batch's.
  float* total = static_cast<Fp32Lane&>(*lanes.front()).gradients().data();
  pool.run_ranges(gradient_size_, 1 << 14, [&](std::size_t begin, std::size_t end) {
    for (std::size_t lane = 1; lane < lanes.size(); ++lane) {
      const float* part = static_cast<Fp32Lane&>(*lanes[lane]).gradients().data();
      for (std::size_t i = begin; i < end; ++i) total[i] += part[i];
    }
  });
  const auto bias_sum = [&](const PackedLayer& layer, int o) {
    float sum = 0;
    for (int v = 0; v < vector; ++v) sum += total[layer.bias_gradient + static_cast<std::size_t>(o) * vector + v];
    return sum;
  };

  pool.run(kFp32Layers, [&](int l) {
    const PackedLayer& layer = layers_[l];
    const NerfLayerShape shape = nerf_layer(config_, field_layer(l));
    const int first = l == kFp32Colour ? width : 0;  // its first part follows below
    for (int o = 0; o < shape.outputs; ++o) {
      const float* from = total + layer.gradient + static_cast<std::size_t>(o) * (layer.k1 + layer.k2);
      float* to = gradients.data() + shape.weight + static_cast<std::size_t>(o) * shape.inputs;
      for (int k = first; k < shape.inputs; ++k) to[k] += from[k];
      gradients[shape.bias + o] += bias_sum(layer, o);
    }
  });

  // dWf = Wc^T G, dbf = Wc^T g, dWc = G Wf^T + g bf^T.
  const PackedLayer& folded = layers_[kFp32Colour];
  const NerfLayerShape feature = nerf_layer(config_, kNerfFeature), colour = nerf_layer(config_, kNerfColour);
  const std::ptrdiff_t folded_stride = folded.k1 + folded.k2;
  MatrixProduct d_feature;
  d_feature.a = colour_.data(), d_feature.a_row = 1, d_feature.a_step = width;
  d_feature.b = total + folded.gradient, d_feature.b_step = folded_stride;
  d_feature.rows = width, d_feature.columns = width, d_feature.steps = width / 2;
  d_feature.out = gradients.data() + feature.weight, d_feature.out_stride = width;
  multiply_rows(d_feature, pool);
  MatrixProduct d_colour;
  d_colour.a = total + folded.gradient, d_colour.a_row = folded_stride, d_colour.a_step = 1;
  d_colour.b = feature_transposed_.data(), d_colour.b_step = width;
  d_colour.rows = width / 2, d_colour.columns = width, d_colour.steps = width;
  d_colour.out = gradients.data() + colour.weight, d_colour.out_stride = colour.inputs;
  multiply_rows(d_colour, pool);
  for (int o = 0; o < width / 2; ++o) {
    const float g = bias_sum(folded, o);
    float* d_row = gradients.data() + colour.weight + static_cast<std::size_t>(o) * colour.inputs;
    const float* row = colour_.data() + static_cast<std::size_t>(o) * width;
    for (int k = 0; k < width; ++k) {
      d_row[k] += g * feature_bias_[k];
      gradients[feature.bias + k] += g * row[k];
    }
  }
}

std::unique_ptr<NerfNetwork> make_nerf_avx2(const NerfConfig& config) {
  return std::make_unique<Fp32Network>(config, avx2::kFp32Kernels);
}
std::unique_ptr<NerfNetwork> make_nerf_avx512(const NerfConfig& config) {
  return std::make_unique<Fp32Network>(config, avx512::kFp32Kernels);
}

}  // namespace redrive::kernels
