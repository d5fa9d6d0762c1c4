// SPDX-License-Identifier: Apache-2.0
// Sampler of LiDAR returns as training rays, in an order shuffled anew each epoch (as
// PixelSampler).
#pragma once

#include <cstdint>

#include "redrive/rays/ray_table.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

/// Divergence of a LiDAR beam in rad; data sheets of common sensors give 0.1 to 0.2 degrees.
constexpr float kLidarBeamAngle_rad = 0.002f;

class LidarSampler {
 public:
  /// Returns and scene must outlive the sampler; the returns stay unchanged.
  LidarSampler(const LidarReturns& returns, const Scene& scene, std::uint64_t seed);
  LidarSampler(const LidarSampler&) = delete;
  LidarSampler& operator=(const LidarSampler&) = delete;

  /// Gathers batch `step` (from 0): n rays in the world of the scene's poses as they are now, with
  /// range_m, without colours. There must be returns.
  void gather(std::int64_t step, int n, RayBatch* batch) const;

 private:
  const LidarReturns& returns_;
  const Scene& scene_;
  std::uint64_t seed_;
};

}  // namespace redrive
