// SPDX-License-Identifier: Apache-2.0
// Rendering front to back with early ray termination: samples behind an opaque surface are not
// computed.
#pragma once

#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/cpu/composite_range.h"
#include "redrive/kernels/nerf/cpu/nerf_tile.h"
#include "redrive/kernels/nerf/nerf_stages.h"

namespace redrive::kernels {

/// Computes the network for the next kStride samples of each active ray of a block, then drops the
/// rays whose transmittance fell below kMinTransmittance, and so on. Skipped samples change a ray's
/// colour, opacity and sum of weights by less than kMinTransmittance; rays that are not dropped get
/// the same bits as in one pass.
class FrontToBack {
 public:
  static constexpr double kMinTransmittance = 1e-4;  ///< a fortieth of a step of an 8-bit image
  static constexpr int kStride = 16;  ///< samples between two tests: one vector of AVX-512

  /// `tile_samples`: the maximum of samples per call of the chunk; at least kStride or per_ray.
  FrontToBack(int per_ray, int tile_samples);

  /// Returns raw [4, n * per_ray] of the block's rays; skipped samples have density -1 (no
  /// absorption). Valid until the next call.
  const float* run(NerfChunk& chunk, const NerfField& field, const Rays& rays,
                   const Samples& samples, RayRange block);
  std::size_t raw_stride() const { return static_cast<std::size_t>(block_rays_) * per_ray_; }
  int block_rays() const { return block_rays_; }  ///< maximum of rays per block

 private:
  const int per_ray_, tile_samples_, block_rays_;
  std::vector<int> open_;              ///< active rays of the block, in order
  std::vector<double> optical_depth_;  ///< sum of sigma dt so far, one per ray of the block
  Buffer<float> raw_, tile_raw_, position_, direction_;
};

}  // namespace redrive::kernels
