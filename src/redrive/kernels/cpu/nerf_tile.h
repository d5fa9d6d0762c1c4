// SPDX-License-Identifier: Apache-2.0
// What an ISA has to provide for the NeRF network. The cpu backend cuts a batch into tiles of whole
// rays; a chunk (one of a fixed number, base/parallel.h) runs a fixed list of tiles, forward then
// backward while the activations are in cache, and sums its own gradients. A new ISA is one
// implementation of the two classes below and a line in cpu_kernels.cc.
#pragma once

#include <memory>
#include <span>

#include "redrive/base/parallel.h"
#include "redrive/field/nerf_field.h"

namespace redrive::kernels {

/// Points of a tile: sample i = ray * per_ray + s. position [3, n_rays * per_ray] in the unit cube,
/// direction [3, n_rays] unit length, both structure of arrays (x of all, then y, then z). Any n >=
/// 1: the chunk pads.
struct NerfTile {
  int n_rays = 0, per_ray = 0;
  const float* position = nullptr;
  const float* direction = nullptr;
  int samples() const { return n_rays * per_ray; }
};

class NerfChunk {
 public:
  virtual ~NerfChunk() = default;
  /// Must be called on the thread that runs the chunk, before its first tile of a batch (AMX: loads
  /// the tile shapes).
  virtual void begin() = 0;
  virtual void end() = 0;  ///< AMX: releases the tiles
  virtual void clear_gradients() = 0;
  /// raw [4, stride]: r, g, b, density of sample i at raw[k * stride + i], linear outputs. `keep`:
  /// backward follows.
  virtual void forward(const NerfTile& tile, bool keep, float* raw, int stride) = 0;
  /// Adjoint of the last forward(keep = true): adds to the chunk's gradients. d_raw as raw. Samples
  /// past tile.samples() contribute nothing. d_position [3, tile.samples()], unless null: d loss /
  /// d position, written (it costs two more products).
  virtual void backward(const float* d_raw, int stride, float* d_position) = 0;
};

class NerfNetwork {
 public:
  virtual ~NerfNetwork() = default;
  virtual int tile_samples()
      const = 0;  ///< preferred samples a tile; a ray that is longer makes a tile of its own
  /// Takes the parameters (field/nerf_field.h layout) into this ISA's layout; every batch, in
  /// parallel.
  virtual void pack(std::span<const float> parameters, ThreadPool& pool) = 0;
  virtual std::unique_ptr<NerfChunk> make_chunk(int max_samples) = 0;
  /// Adds the gradients of the chunks, in their order, to `gradients` (field/nerf_field.h layout).
  virtual void reduce(std::span<const std::unique_ptr<NerfChunk>> chunks,
                      std::span<float> gradients, ThreadPool& pool) = 0;
};

// One per ISA; call only where isa_obstacle(isa) is empty.
std::unique_ptr<NerfNetwork> make_nerf_avx2(const NerfConfig& config);
std::unique_ptr<NerfNetwork> make_nerf_avx512(const NerfConfig& config);
std::unique_ptr<NerfNetwork> make_nerf_avx512_bf16(const NerfConfig& config);
std::unique_ptr<NerfNetwork> make_nerf_amx_bf16(const NerfConfig& config);
/// The AMX path with its tile instructions replaced by plain loops: tests its layouts where there
/// is no AMX (needs AVX-512 with BF16, for the conversions).
std::unique_ptr<NerfNetwork> make_nerf_amx_emulated(const NerfConfig& config);

}  // namespace redrive::kernels
