// SPDX-License-Identifier: Apache-2.0
// Interface of the NeRF network of one instruction set. The cpu backend cuts a batch into tiles of
// whole rays. A chunk, one of a fixed number per batch, runs a fixed list of tiles on one thread,
// forward and then backward while the activations are in cache, and sums its own gradients. A new
// instruction set implements the two classes below and gets a line in the backend's table.
#pragma once

#include <memory>
#include <span>

#include "redrive/base/parallel.h"
#include "redrive/field/nerf_field.h"

namespace redrive::kernels {

/// Points of a tile: sample i = ray * per_ray + s. position [3, n_rays * per_ray] in the unit cube,
/// direction [3, n_rays] of unit length, both structure of arrays. Any n_rays >= 1: the chunk pads.
struct NerfTile {
  int n_rays = 0, per_ray = 0;
  const float* position = nullptr;
  const float* direction = nullptr;
  int samples() const { return n_rays * per_ray; }
};

class NerfChunk {
 public:
  virtual ~NerfChunk() = default;
  virtual void clear_gradients() = 0;
  /// Writes raw [4, stride]: r, g, b, density of sample i at raw[k * stride + i], linear outputs.
  /// `keep`: keeps the activations for backward.
  virtual void forward(const NerfTile& tile, bool keep, float* raw, int stride) = 0;
  /// Backward pass of the last forward(keep = true): adds to the chunk's gradients. d_raw as raw;
  /// padding samples contribute nothing. d_position [3, tile.samples()] or null: written (two more
  /// products).
  virtual void backward(const float* d_raw, int stride, float* d_position) = 0;
};

class NerfNetwork {
 public:
  virtual ~NerfNetwork() = default;
  virtual int tile_samples()
      const = 0;  ///< preferred samples per tile; a longer ray is a tile of its own
  /// Packs the parameters (layout of field/nerf_field.h) into this instruction set's layout; once
  /// per batch, in parallel.
  virtual void pack(std::span<const float> parameters, ThreadPool& pool) = 0;
  virtual std::unique_ptr<NerfChunk> make_chunk(int max_samples) = 0;
  /// Adds the gradients of the chunks, in their order, to `gradients` (layout of
  /// field/nerf_field.h).
  virtual void reduce(std::span<const std::unique_ptr<NerfChunk>> chunks,
                      std::span<float> gradients, ThreadPool& pool) = 0;
};

// One per instruction set; call only if isa_obstacle(isa) is empty.
std::unique_ptr<NerfNetwork> make_nerf_avx2(const NerfConfig& config);
std::unique_ptr<NerfNetwork> make_nerf_avx512(const NerfConfig& config);
std::unique_ptr<NerfNetwork> make_nerf_avx512_bf16(const NerfConfig& config);

}  // namespace redrive::kernels
