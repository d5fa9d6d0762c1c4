// SPDX-License-Identifier: Apache-2.0
// Interface between the files that are compiled for AVX-512 and the portable network.cc: plain
// structs of sizes, offsets and pointers, and functions. The files compiled for AVX-512 include
// nothing else of the project and define everything else in unnamed namespaces, so that no inline
// function of theirs can be linked into code that runs anywhere.
#pragma once

#include <cstddef>
#include <cstdint>

#include "redrive/kernels/cpu/simd/bf16_layout.h"

namespace redrive::kernels::bf16 {

/// Layers as computed: 0..7 trunk, then these. Colour is feature and colour folded
/// (folded_colour.h). Density is its last block of outputs (row 0), with zero weights for gamma(d).
enum PlanLayer { kTrunkLayers = 8, kColour = 8, kRgb = 9, kPlanLayers = 10 };

struct Layer {
  int in_blocks = 0;  ///< inputs from the previous layer (layer 0: from gamma(x))
  int extra_blocks =
      0;  ///< the concatenated encoding that follows them (skip: gamma(x), colour: gamma(d))
  int k_blocks = 0;  ///< in_blocks + extra_blocks
  int out_blocks = 0;
  std::size_t forward = 0;  ///< in Weights::packed: [out_blocks][k_blocks] blocks in row form
  int backward_blocks = 0;  ///< inputs that get a gradient, the first of k_blocks: all but gamma(d)
  std::size_t backward =
      0;  ///< in Weights::packed: [backward_blocks][out_blocks] blocks in pair form
  std::size_t bias_tile = 0;  ///< in Weights::bias: [out_blocks][kBiasTile]
  std::size_t d_weight =
      0;  ///< in ChunkMemory::d_weight: [out_blocks][k_blocks] C blocks, rows = inputs
  std::size_t d_bias = 0;  ///< in ChunkMemory::d_bias: [out_blocks][32]
};

struct Plan {
  int width_blocks = 0, colour_blocks = 0, position_blocks = 0, direction_blocks = 0;
  int position_octaves = 0, direction_octaves = 0;
  Layer layers[kPlanLayers];
  std::size_t packed_size = 0, bias_size = 0, d_weight_size = 0, d_bias_size = 0;
};

/// Up to 32 outputs of a layer: the unit of packing and of reduction. In the flat parameters: row o
/// at weight + o * columns, bias at bias + o, or the same in FoldedColour's if `folded`. The other
/// members as in Layer, for this block of outputs.
struct BlockRow {
  bool folded = false;
  std::size_t weight = 0, bias = 0;
  int rows = 0, columns = 0;
  int k_blocks = 0, backward_blocks = 0, backward_stride = 0;
  std::size_t forward = 0, backward = 0, bias_tile = 0, d_weight = 0, d_bias = 0;
};

struct Weights {
  Bf16* packed = nullptr;
  float* bias = nullptr;
};

/// Buffers of a chunk, for up to `n` blocks of 32 samples. Layouts: simd/bf16_layout.h.
struct ChunkMemory {
  Bf16 *position_next = nullptr, *position_keep = nullptr;    ///< gamma(x)
  Bf16 *direction_next = nullptr, *direction_keep = nullptr;  ///< gamma(d)
  Bf16* ray_code = nullptr;               ///< gamma(d) of each ray, [n_rays][direction_blocks * 32]
  Bf16* next[2] = {};                     ///< activations, alternating between layers
  Bf16* keep[kRgb] = {};                  ///< activations of every layer
  std::uint32_t* mask[kRgb] = {};         ///< [out_blocks][n][32 samples], bit = neuron active
  Bf16 *d_next[2] = {}, *d_keep[2] = {};  ///< gradients, alternating between layers
  Bf16 *d_rgb_next = nullptr, *d_rgb_keep = nullptr;
  /// derivatives of gamma(x), from the skip and from layer 0: [n][position_blocks] C blocks, rows =
  /// samples
  float* d_gamma[2] = {};
  float* d_weight = nullptr;
  float* d_bias = nullptr;
  bool fresh = true;  ///< d_weight is uninitialised: the first visit overwrites instead of adding
};

/// NerfTile (nerf_tile.h) as a plain struct.
struct TileInput {
  int n_rays = 0, per_ray = 0;
  const float* position = nullptr;
  const float* direction = nullptr;
};

// The functions below are compiled for Isa::kAvx512Bf16 and must only be called where it is usable.

/// gamma(x) and gamma(d) of a tile into position_* and direction_*; samples past the tile's are
/// zero (keep: *_keep too).
void encode_tile(const Plan& plan, const ChunkMemory& memory, const TileInput& tile, bool keep);

/// Writes d_position [3, samples], the adjoint of gamma(x) (positional_encoding_adjoint in
/// field/positional_encoding.h) of the sum of memory.d_gamma. Sines and cosines are the network's
/// rounded inputs (memory.position_keep).
void encode_positions_backward(const Plan& plan, const ChunkMemory& memory, int samples,
                               float* d_position);

/// encode_tile, then the network. raw [4, stride].
void forward_tile(const Plan& plan, const Weights& weights, const ChunkMemory& memory,
                  const TileInput& tile, bool keep, float* raw, int stride);

/// Adds to memory.d_weight (overwrites it if memory.fresh) and memory.d_bias. d_position [3,
/// samples], unless null: written.
void backward_tile(const Plan& plan, const Weights& weights, const ChunkMemory& memory, int samples,
                   const float* d_raw, int stride, float* d_position);

/// Rows in row form for the forward pass, in pair form (pairs of outputs) for the backward pass,
/// and the bias tile. Outputs past row.rows and inputs past row.columns are zero, so padded neurons
/// are 0 and get no gradient.
void pack_row(const BlockRow& row, const float* parameters, const Weights& weights);

/// gradients += ((chunk 0 + chunk 1) + chunk 2) + ...
void reduce_row(const BlockRow& row, const ChunkMemory* const* chunks, int n_chunks,
                float* gradients);

/// One block, for tests: c = bias (kBiasTile, or null: 0) + sum_k a_k b_k.
void multiply_blocks(const Bf16* a, const Bf16* b, int k_blocks, const float* bias, float* c);
/// One block, for tests: c = (clear ? 0 : c) + sum_k a_k b_k.
void accumulate_blocks(const Bf16* a, const Bf16* b, int k_blocks, bool clear, float* c);

}  // namespace redrive::kernels::bf16
