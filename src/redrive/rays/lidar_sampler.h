// SPDX-License-Identifier: Apache-2.0
// Sampler of LiDAR returns as training rays, in an order shuffled anew each epoch (as
// PixelSampler).
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/rays/gather_returns.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/lidar_returns.h"

namespace redrive {

class LidarSampler {
 public:
  /// The returns must outlive the sampler and stay unchanged.
  LidarSampler(const LidarReturns& returns, std::uint64_t seed);
  LidarSampler(const LidarSampler&) = delete;
  LidarSampler& operator=(const LidarSampler&) = delete;

  /// Moves the returns with the frames: from the world by the `recorded` poses to that by the poses
  /// `now`.
  void update_poses(const Rigid3d& global_from_world, const std::vector<FramePose>& recorded,
                    const std::vector<FramePose>& now);

  /// Gathers batch `step` (from 0): n rays with range_m, without colours. There must be returns.
  void gather(std::int64_t step, int n, RayBatch* batch) const;

 private:
  std::uint64_t seed_;
  std::vector<PlainFrame> recorded_, now_;
  LidarSpans source_;
};

}  // namespace redrive
