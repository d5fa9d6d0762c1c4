// SPDX-License-Identifier: Apache-2.0
// A chunk of the fp32 network: the activations of a tile and the gradients of all its tiles.
#pragma once

#include <span>

#include "redrive/kernels/nerf/cpu/fp32/fp32_network.h"

namespace redrive::kernels {

class Fp32Chunk final : public NerfChunk {
 public:
  Fp32Chunk(const Fp32Network& network, int max_samples);

  void clear_gradients() override;
  void forward(const NerfTile& tile, bool keep, float* raw, int stride) override;
  void backward(const float* d_raw, int stride, float* d_position) override;

  std::span<float> gradients() { return gradients_; }  ///< at PackedLayer's offsets

 private:
  void encode(const NerfTile& tile);
  void dense(int layer, const float* in1, const float* in2, float* out, bool relu);
  /// d_in = W^T [d_out1; d_out2], 0 where the activation `mask` is.
  void dense_backward(int layer, const float* d_out1, const float* d_out2, const float* mask,
                      float* d_in);
  /// d_gamma_ of the skip layer or the first: W^T d_out.
  void position_backward(int layer, const float* d_out);
  /// Adds the gradients of `layer`'s weight and bias.
  void accumulate(int layer, const float* d_out, const float* in1, const float* in2);
  void accumulate_part(int layer, const float* d_out, const float* in, int inputs,
                       int first_column);

  const Fp32Network& network_;
  const Fp32Kernels& kernels_;
  int max_samples_;
  int count_ = 0, samples_ = 0;  ///< size of the tile; samples are padded to whole vectors
  // Activations in panels (fp32_kernels.h), each [features, samples].
  Buffer<float> position_, direction_, ray_direction_;
  std::array<Buffer<float>, kNerfHidden> hidden_;
  Buffer<float> colour_, density_, rgb_;
  Buffer<float> d_front_, d_back_, d_density_,
      d_rgb_;  ///< adjoints, made as the first backward needs them
  /// derivatives of gamma(x), from the skip layer and from the first; made when first wanted
  std::array<Buffer<float>, 2> d_gamma_;
  Buffer<float> transposed_;
  Buffer<float> gradients_;
};

}  // namespace redrive::kernels
