// SPDX-License-Identifier: Apache-2.0
// The training rays of a LiDAR: its returns in an order shuffled anew each time all have been seen
// (as PixelSampler).
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/kernels/gather/gather_returns.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/lidar_returns.h"

namespace redrive {

class LidarSampler {
 public:
  /// The returns have to outlive it, and to stay as they are.
  LidarSampler(const LidarReturns& returns, std::uint64_t seed);
  LidarSampler(const LidarSampler&) = delete;
  LidarSampler& operator=(const LidarSampler&) = delete;

  /// Returns that lie in the world as `recorded` has the frames go with them to where these are
  /// now.
  void place(const Rigid3d& global_from_world, const std::vector<FramePose>& recorded,
             const std::vector<FramePose>& now);

  /// Batch `step` (from 0): n rays with range_m, without colours. There must be returns.
  void gather(std::int64_t step, int n, RayBatch* batch) const;

  /// gather() in its parts, for backends that gather themselves: what is drawn, room for it, and
  /// what it is drawn from.
  LidarDraw draw(std::int64_t step, int n) const;
  static GatheredReturns resize_batch(int n, RayBatch* batch);
  const LidarSource& source() const { return source_; }

 private:
  std::uint64_t seed_;
  std::vector<PlainFrame> recorded_, now_;
  LidarSource source_;
};

}  // namespace redrive
