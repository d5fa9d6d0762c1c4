// SPDX-License-Identifier: Apache-2.0
// Rays that a moving sensor fires, in the world.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// Rays in the world. Floats resolve 0.1 mm within 1 km of the first frame.
struct LidarRays {
  std::vector<float> origin;     ///< [3, n] position of the sensor, metres
  std::vector<float> direction;  ///< [3, n] unit
  Eigen::Vector3f origin_at(std::size_t i) const { return at(origin, i); }
  Eigen::Vector3f direction_at(std::size_t i) const { return at(direction, i); }

 private:
  static Eigen::Vector3f at(const std::vector<float>& values, std::size_t i) {
    const std::size_t n = values.size() / 3;
    return {values[i], values[n + i], values[2 * n + i]};
  }
};

/// Returns the pose of a sensor in the world at a time, host clock.
using SensorPoses = std::function<Rigid3d(std::int64_t t_ns)>;

/// Rays fired at the times t_ns [n]. `direction`: returns the unit vector of a ray in the sensor's
/// axes. A pose is evaluated once for consecutive rays of one time. Both are called by several
/// threads at once if there is a pool.
LidarRays fire(std::span<const std::int64_t> t_ns,
               const std::function<Eigen::Vector3d(std::size_t)>& direction,
               const SensorPoses& world_from_sensor, ThreadPool* pool = nullptr);

}  // namespace redrive
