// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/lidar_sampler.h"

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {

LidarSampler::LidarSampler(const LidarReturns& returns, const Scene& scene, std::uint64_t seed)
    : returns_(returns), scene_(scene), seed_(seed) {}

void LidarSampler::gather(std::int64_t step, int n, RayBatch* batch) const {
  REDRIVE_CHECK_OP(returns_.n, >, 0u);
  REDRIVE_CHECK_OP(step, >=, 0);
  const std::size_t rays = n;
  batch->n = n;
  for (auto* xyz : {&batch->origin, &batch->direction}) xyz->resize(3 * rays);
  batch->pixel_angle.assign(rays, kLidarBeamAngle_rad);
  batch->range_m.resize(rays);
  batch->target.clear();
  batch->background.clear();
  batch->exposure.clear();
  LidarPoses poses(scene_, returns_);
  for (std::size_t i = 0; i < rays; ++i) {
    const std::uint64_t drawn = static_cast<std::uint64_t>(step) * rays + i,
                        key = random_key(seed_, kStreamLidar, drawn / returns_.n);
    const std::size_t k = permute_index(key, drawn % returns_.n, returns_.n);
    batch->range_m[i] = returns_.range_m[k];
    const Rigid3d& world_from_sensor = poses.at(k);
    const Eigen::Vector3d origin = world_from_sensor.translation(),
                          direction = world_from_sensor.linear() * returns_.direction_in_sensor(k);
    for (int d = 0; d < 3; ++d) {
      batch->origin[d * rays + i] = static_cast<float>(origin[d]);
      batch->direction[d * rays + i] = static_cast<float>(direction[d]);
    }
  }
}

}  // namespace redrive
