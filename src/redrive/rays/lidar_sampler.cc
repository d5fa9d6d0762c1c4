// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/lidar_sampler.h"

#include "redrive/base/error.h"

namespace redrive {
namespace {

std::vector<PlainFrame> plain_frames(const std::vector<FramePose>& frames) {
  std::vector<PlainFrame> out;
  for (const FramePose& frame : frames) out.push_back({frame.t_ns, plain(frame.global_from_body)});
  return out;
}

/// Resizes a batch to n rays and returns its spans.
GatheredReturns resize_batch(int n, RayBatch* batch) {
  const std::size_t rays = n;
  batch->n = n;
  for (auto* xyz : {&batch->origin, &batch->direction}) xyz->resize(3 * rays);
  for (auto* each : {&batch->pixel_angle, &batch->range_m}) each->resize(rays);
  batch->target.clear();
  batch->background.clear();
  batch->exposure.clear();
  return {batch->origin, batch->direction, batch->pixel_angle, batch->range_m};
}

}  // namespace

LidarSampler::LidarSampler(const LidarReturns& returns, std::uint64_t seed) : seed_(seed) {
  source_ = {returns.origin, returns.direction, returns.range_m, returns.t_ns, {}, {}, {}};
}

void LidarSampler::update_poses(const Rigid3d& global_from_world,
                                const std::vector<FramePose>& recorded,
                                const std::vector<FramePose>& now) {
  REDRIVE_CHECK(!recorded.empty());
  REDRIVE_CHECK_OP(now.size(), ==, recorded.size());
  recorded_ = plain_frames(recorded);
  now_ = plain_frames(now);
  source_.global_from_world = plain(global_from_world);
  source_.recorded = recorded_;
  source_.poses = now_;
}

void LidarSampler::gather(std::int64_t step, int n, RayBatch* batch) const {
  REDRIVE_CHECK_OP(source_.range_m.size(), >, 0u);
  REDRIVE_CHECK_OP(step, >=, 0);
  const LidarDraw draw{seed_, static_cast<std::uint64_t>(step) * static_cast<std::uint64_t>(n)};
  gather_returns(source_, draw, resize_batch(n, batch));
}

}  // namespace redrive
