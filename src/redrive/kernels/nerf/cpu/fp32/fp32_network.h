// SPDX-License-Identifier: Apache-2.0
// The NeRF network in fp32 on the inner loops of one instruction set. Compiled without ISA flags.
// Feature and colour layers are one (folded_colour.h).
#pragma once

#include <array>
#include <memory>

#include "redrive/base/buffer.h"
#include "redrive/kernels/nerf/cpu/folded_colour.h"
#include "redrive/kernels/nerf/cpu/fp32/fp32_kernels.h"
#include "redrive/kernels/nerf/cpu/nerf_tile.h"

namespace redrive::kernels {

/// Layers as computed: 0..7 trunk, then these. Inputs and outputs are padded with zero weights to
/// the inner loops' block sizes.
enum Fp32Layer { kFp32Colour = 8, kFp32Density = 9, kFp32Rgb = 10, kFp32Layers = 11 };

struct PackedLayer {
  int k1 = 0,
      k2 = 0;       ///< padded inputs: the layer before (or gamma(x)), the concatenated encoding
  int outputs = 0;  ///< padded
  std::size_t gradient =
      0;  ///< offset of the weight's gradient [outputs, k1 + k2] in a chunk's buffer
  std::size_t bias_gradient = 0;  ///< offset of the bias's [outputs, lanes]
  Buffer<float> plain;            ///< [outputs, k1 + k2] row-major
  Buffer<float> forward;          ///< plain, packed for DenseLayer
  Buffer<float> bias;             ///< [outputs]
};

class Fp32Network final : public NerfNetwork {
 public:
  Fp32Network(const NerfConfig& config, const Fp32Kernels& kernels);

  int tile_samples() const override;
  void pack(std::span<const float> parameters, ThreadPool& pool) override;
  std::unique_ptr<NerfChunk> make_chunk(int max_samples) override;
  void reduce(std::span<const std::unique_ptr<NerfChunk>> chunks, std::span<float> gradients,
              ThreadPool& pool) override;

 private:
  friend class Fp32Chunk;
  /// Layout of the layer in the parameters; of kFp32Colour in folded_'s.
  NerfLayerShape shape_of(int layer) const;

  NerfConfig config_;
  const Fp32Kernels& kernels_;
  int position_rows_, direction_rows_;  ///< rows of the encodings, padded
  std::array<PackedLayer, kFp32Layers> layers_;
  /// The transposes for d_in = W^T d_out, packed for DenseLayer: trunk 1..7 (index as layers_; only
  /// the skip layer's part for h), [colour; density] with respect to h (kFp32Colour), rgb
  /// (kFp32Rgb).
  std::array<Buffer<float>, kFp32Layers> backward_;
  /// Transposes with respect to gamma(x), of the skip layer and of the first.
  std::array<Buffer<float>, 2> position_backward_;
  std::size_t gradient_size_ = 0;  ///< floats of a chunk's buffer
  FoldedColour folded_;
};

}  // namespace redrive::kernels
