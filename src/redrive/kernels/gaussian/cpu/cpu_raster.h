// SPDX-License-Identifier: Apache-2.0
// An image of Gaussians on the cpu backend: projection, depth order, blending, and its backward
// pass. Cuts images and Gaussians into ranges for an instruction set's kernels.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/cpu/gaussian_kernels.h"
#include "redrive/kernels/gaussian/host_raster.h"

namespace redrive::kernels {

constexpr std::size_t kBlocksPerRange = 256;  ///< 4096 Gaussians

/// Returns `buffer` with at least n numbers of any value. spare: additional capacity.
template <class T>
T* grown(Buffer<T>* buffer, std::size_t n, std::size_t spare = 0) {
  if (buffer->size() < n) {
    *buffer = {};  // not both at once
    *buffer = Buffer<T>(n + spare);
  }
  return buffer->data();
}

/// Returns working memory of a tile or a row; there is one for each thread.
float* tile_memory(std::size_t floats);

UpdateJob update_job(const GaussianUpdate& update);

/// Blocks of Gaussians that are seen from the same poses.
struct Segment {
  std::size_t begin, end;   ///< blocks
  ShutterKeys shutter;      ///< n = 0: not drawn
  std::vector<float> keys;  ///< keys of the shutter
};

/// Returns blocks [begin, end) as `camera` sees them from these poses at the edges of its image.
Segment make_segment(const GaussianCamera& camera, std::span<const PlainPose> poses,
                     std::size_t begin, std::size_t end);

class CpuRaster final : public HostRaster {
 public:
  CpuRaster(const GaussianKernels& kernels, GaussianStages* stages, ThreadPool* pool)
      : HostRaster(stages, pool), kernels_(kernels), pool_(*pool) {}

  void forward(const GaussianCamera& camera, const Gaussians& gaussians,
               const RasterOptions& options);
  using HostRaster::backward;
  void backward(const RasterGradient& gradient, const GaussianDerivatives& to,
                std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) override;

 private:
  /// Sets grid_.
  void set_grid();
  /// Sets segments_: the world, then the parts.
  void set_segments();
  /// Sets records_, visible_, keys_ and n_visible_.
  void project();
  /// Sets pairs_, by tile and in each by distance, and first_.
  void bin();
  /// Sets the image's parts and extents.
  void find_parts();
  /// Calls body(segment, first block, last block) for the segments that overlap the blocks.
  template <class Body>
  void for_segments(std::size_t begin, std::size_t end, const Body& body) const;
  /// Runs body on a Job for each wanted tile.
  template <class Job, class Body>
  void for_tiles(const Body& body) const;
  template <class T>
  T* scratch_of(std::size_t n) {
    const std::size_t bytes = n * sizeof(T);
    return reinterpret_cast<T*>(grown(&scratch_, bytes, bytes / 16));
  }

  const GaussianKernels& kernels_;
  ThreadPool& pool_;
  GaussianCamera camera_;
  Gaussians gaussians_;
  Buffer<RasterRecord> records_;   ///< one per Gaussian
  Buffer<std::uint16_t> visible_;  ///< one per block
  /// keys of the visible Gaussians: distance, tiles (kTileBits), index
  Buffer<std::uint64_t> keys_;
  Buffer<TilePair> pairs_;
  /// In turn: keys between two passes of their sort, pairs in the order of their making, sums
  /// [pairs, kRecordFloats] of floats.
  Buffer<std::byte> scratch_;
  std::vector<std::uint32_t> first_;  ///< [tiles + 1]: first pair of each tile
  std::size_t n_visible_ = 0;
  std::vector<Segment> segments_;
  TileGrid grid_;
  Buffer<float> boxes_;         ///< TileGrid::boxes
  std::vector<float> extents_;  ///< along_u.low and along_u.high of grid_, then along_v's
};

}  // namespace redrive::kernels
