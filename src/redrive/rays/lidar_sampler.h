// SPDX-License-Identifier: Apache-2.0
// The training rays of a LiDAR: its returns in an order shuffled anew each time all have been seen (as PixelSampler).
#pragma once

#include <cstdint>
#include <functional>

#include "redrive/rays/ray_table.h"
#include "redrive/scene/lidar_returns.h"

namespace redrive {

class LidarSampler {
 public:
  LidarSampler(const LidarReturns& returns, std::uint64_t seed) : returns_(returns), seed_(seed) {}

  /// What has become of the world that returns of a time lie in.
  using Moved = std::function<Rigid3d(std::int64_t t_ns)>;

  /// Batch `step` (from 0): n rays with range_m, without colours, where `moved`, if it is one, puts them. There must be returns.
  void gather(std::int64_t step, int n, RayBatch* batch, const Moved& moved = {}) const;

 private:
  const LidarReturns& returns_;
  std::uint64_t seed_;
};

}  // namespace redrive
