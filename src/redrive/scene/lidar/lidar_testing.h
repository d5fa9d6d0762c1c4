// SPDX-License-Identifier: Apache-2.0
// For tests: returns of points that are known in the world.
#pragma once

#include <span>

#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

/// A point in the world and when it is measured.
struct MeasuredPoint {
  Eigen::Vector3d in_world;
  std::int64_t t_ns = 0;
};

/// Returns of the points, measured without error by a sensor with the body's axes, by the recorded
/// poses of `scene`. Intensities are 0.
inline LidarReturns returns_of(const Scene& scene, std::span<const MeasuredPoint> points,
                               const Eigen::Vector3d& sensor_in_body = Eigen::Vector3d::Zero()) {
  LidarReturns returns;
  returns.n = points.size();
  returns.sensors = {{Rigid3d(Eigen::Translation3d(sensor_in_body))}};
  returns.direction.resize(3 * returns.n);
  returns.intensity.assign(returns.n, 0);
  for (const MeasuredPoint& point : points) {
    const std::size_t i = returns.range_m.size();
    const Rigid3d world_from_sensor =
        scene.world_from_body(point.t_ns, Poses::kRecorded) * returns.sensors[0].body_from_sensor;
    const Eigen::Vector3d in_sensor = world_from_sensor.inverse() * point.in_world;
    for (int k = 0; k < 3; ++k)
      returns.direction[k * returns.n + i] = static_cast<float>(in_sensor[k] / in_sensor.norm());
    returns.range_m.push_back(static_cast<float>(in_sensor.norm()));
    returns.t_ns.push_back(point.t_ns);
  }
  return returns;
}

}  // namespace redrive
