// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_rays.h"

namespace redrive {

LidarRays fire(std::span<const std::int64_t> t_ns,
               const std::function<Eigen::Vector3d(std::size_t)>& direction,
               const SensorPoses& world_from_sensor, ThreadPool* pool) {
  constexpr std::size_t kRaysPerPart = 16384;
  const std::size_t n = t_ns.size();
  LidarRays rays{std::vector<float>(3 * n), std::vector<float>(3 * n)};
  const auto fire_part = [&](std::size_t begin, std::size_t end) {
    Rigid3d pose;
    for (std::size_t i = begin; i < end; ++i) {
      if (i == begin || t_ns[i] != t_ns[i - 1]) pose = world_from_sensor(t_ns[i]);
      const Eigen::Vector3d in_world = pose.linear() * direction(i);
      for (std::size_t k = 0; k < 3; ++k) {
        rays.origin[k * n + i] = static_cast<float>(pose.translation()[Eigen::Index(k)]);
        rays.direction[k * n + i] = static_cast<float>(in_world[Eigen::Index(k)]);
      }
    }
  };
  if (pool)
    pool->run_ranges(n, kRaysPerPart, fire_part);
  else
    fire_part(0, n);
  return rays;
}

}  // namespace redrive
