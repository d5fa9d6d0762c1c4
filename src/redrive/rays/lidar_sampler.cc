// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/lidar_sampler.h"

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {
namespace {

/// A beam is a cone, too: data sheets of the sensors in use say 0.1 to 0.2 degrees.
constexpr float kBeamAngle = 0.002f;

}  // namespace

void LidarSampler::gather(std::int64_t step, int n, RayBatch* batch, const Moved& moved) const {
  REDRIVE_CHECK_OP(step, >=, 0);
  REDRIVE_CHECK_OP(returns_.n, >, 0u);
  const std::size_t rays = n;
  batch->n = n;
  for (auto* xyz : {&batch->origin, &batch->direction}) xyz->resize(3 * rays);
  batch->target.clear();
  batch->background.clear();
  batch->exposure.clear();
  batch->pixel_angle.assign(rays, kBeamAngle);
  batch->range_m.resize(rays);
  for (std::size_t i = 0; i < rays; ++i) {
    const std::uint64_t drawn = static_cast<std::uint64_t>(step) * rays + i;
    const std::uint64_t key = random_key(seed_, kStreamLidar, drawn / returns_.n);
    const std::size_t k = permute_index(key, drawn % returns_.n, returns_.n);
    Eigen::Vector3f origin, direction;
    for (int d = 0; d < 3; ++d) {
      origin[d] = returns_.origin[d * returns_.n + k];
      direction[d] = returns_.direction[d * returns_.n + k];
    }
    if (moved) {
      const Rigid3d motion = moved(returns_.t_ns[k]);
      origin = (motion * origin.cast<double>()).cast<float>();
      direction = (motion.linear() * direction.cast<double>()).cast<float>();
    }
    for (int d = 0; d < 3; ++d) {
      batch->origin[d * rays + i] = origin[d];
      batch->direction[d * rays + i] = direction[d];
    }
    batch->range_m[i] = returns_.range_m[k];
  }
}

}  // namespace redrive
