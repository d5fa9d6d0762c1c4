// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/nerf/cpu/fp32/fp32_network.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/kernels/nerf/cpu/fp32/fp32_chunk.h"

namespace redrive::kernels {
namespace {

int round_up(int n, int multiple) { return (n + multiple - 1) / multiple * multiple; }

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
      direction_rows_(round_up(encoded_size(config.direction_octaves), kernels.lanes)),
      folded_(config) {
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
  for (int l = 1; l < kNerfHidden; ++l)
    backward_[l] = Buffer<float>(static_cast<std::size_t>(width) * width);
  for (Buffer<float>& packed : position_backward_)
    packed = Buffer<float>(static_cast<std::size_t>(width) * position_rows_);
  backward_[kFp32Colour] = Buffer<float>(static_cast<std::size_t>(width) * (width / 2 + rows));
  backward_[kFp32Rgb] = Buffer<float>(static_cast<std::size_t>(width / 2) * rows);
}

// 192 samples: two rays of 96 or four of 48; their activations (11 KB each at width 256) stay in
// the cache between forward and backward, and the weights, read once a layer and tile, are 192
// multiply-adds an element.
int Fp32Network::tile_samples() const { return 192; }

NerfLayerShape Fp32Network::shape_of(int layer) const {
  switch (layer) {
    case kFp32Colour: return folded_.shape();
    case kFp32Density: return nerf_layer(config_, kNerfDensity);
    case kFp32Rgb: return nerf_layer(config_, kNerfRgb);
    default: return nerf_layer(config_, layer);
  }
}

void Fp32Network::pack(std::span<const float> parameters, ThreadPool& pool) {
  REDRIVE_CHECK_OP(parameters.size(), ==, nerf_parameter_count(config_));
  const int width = config_.width, rows = kernels_.rows;
  folded_.fold(parameters, pool);
  pool.run(kFp32Layers, [&](int l) {
    PackedLayer& layer = layers_[l];
    const NerfLayerShape shape = shape_of(l);
    const float* p = l == kFp32Colour ? folded_.parameters().data() : parameters.data();
    // The padding follows the last inputs and outputs and is 0 from construction on.
    for (int o = 0; o < shape.outputs; ++o) {
      std::copy_n(p + shape.weight + static_cast<std::size_t>(o) * shape.inputs, shape.inputs,
                  layer.plain.data() + static_cast<std::size_t>(o) * (layer.k1 + layer.k2));
      layer.bias[o] = p[shape.bias + o];
    }
  });
  pool.run(kFp32Layers, [&](int l) {
    PackedLayer& layer = layers_[l];
    const int inputs = layer.k1 + layer.k2;
    const float* plain = layer.plain.data();
    pack_rows(layer.outputs, inputs, rows, layer.forward.data(),
              [&](int o, int k) { return plain[static_cast<std::size_t>(o) * inputs + k]; });
    if (l == 0 || l == kNerfSkip)  // their inputs end with gamma(x)
      pack_rows(position_rows_, width, rows, position_backward_[l == 0].data(), [&](int k, int o) {
        return plain[static_cast<std::size_t>(o + 1) * inputs - position_rows_ + k];
      });
    if (l == 0 || l == kFp32Density) return;
    const float* density = layers_[kFp32Density].plain.data();
    const int d_outputs = l == kFp32Colour ? layer.outputs + rows : layer.outputs;
    pack_rows(layer.k1, d_outputs, rows, backward_[l].data(), [&](int k, int o) {
      return o < layer.outputs ? plain[static_cast<std::size_t>(o) * inputs + k]
                               : density[static_cast<std::size_t>(o - layer.outputs) * width + k];
    });
  });
}

std::unique_ptr<NerfChunk> Fp32Network::make_chunk(int max_samples) {
  return std::make_unique<Fp32Chunk>(*this, max_samples);
}

void Fp32Network::reduce(std::span<const std::unique_ptr<NerfChunk>> chunks,
                         std::span<float> gradients, ThreadPool& pool) {
  REDRIVE_CHECK_OP(gradients.size(), ==, nerf_parameter_count(config_));
  const int vector = kernels_.lanes;
  // Sums all chunks into the first, in their order.
  float* total = static_cast<Fp32Chunk&>(*chunks.front()).gradients().data();
  pool.run_ranges(gradient_size_, 1 << 14, [&](std::size_t begin, std::size_t end) {
    for (std::size_t chunk = 1; chunk < chunks.size(); ++chunk) {
      const float* part = static_cast<Fp32Chunk&>(*chunks[chunk]).gradients().data();
      for (std::size_t i = begin; i < end; ++i) total[i] += part[i];
    }
  });
  pool.run(kFp32Layers, [&](int l) {
    const PackedLayer& layer = layers_[l];
    const NerfLayerShape shape = shape_of(l);
    float* sums = l == kFp32Colour ? folded_.gradients().data() : gradients.data();
    for (int o = 0; o < shape.outputs; ++o) {
      const float* from =
          total + layer.gradient + static_cast<std::size_t>(o) * (layer.k1 + layer.k2);
      float* to = sums + shape.weight + static_cast<std::size_t>(o) * shape.inputs;
      for (int k = 0; k < shape.inputs; ++k) to[k] += from[k];
      float bias = 0;
      for (int v = 0; v < vector; ++v)
        bias += total[layer.bias_gradient + static_cast<std::size_t>(o) * vector + v];
      sums[shape.bias + o] += bias;
    }
  });
  folded_.unfold(gradients, pool);
}

std::unique_ptr<NerfNetwork> make_nerf_avx2(const NerfConfig& config) {
  return std::make_unique<Fp32Network>(config, avx2::kFp32Kernels);
}
std::unique_ptr<NerfNetwork> make_nerf_avx512(const NerfConfig& config) {
  return std::make_unique<Fp32Network>(config, avx512::kFp32Kernels);
}

}  // namespace redrive::kernels
