// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/lidar_scan.h"

namespace redrive {

Rigid3d SensorMotion::world_from_body(std::int64_t t_ns) const {
  return scene.world_from_body(t_ns);
}

Rigid3d SensorMotion::world_from_sensor(std::int64_t t_ns) const {
  return shifted_camera(scene.global_from_world, world_from_body(t_ns), body_from_sensor, axes,
                        shift_m);
}

LidarScan render_scan(kernels::Backend& backend, const Field& model, const LidarFirings& firings,
                      const SensorMotion& motion, const ScanOptions& options) {
  const std::size_t n = firings.size();
  std::vector<float> origin(3 * n), direction(3 * n);
  Rigid3d pose;
  for (std::size_t i = 0; i < n; ++i) {
    if (i == 0 || firings.t_ns[i] != firings.t_ns[i - 1])
      pose = motion.world_from_sensor(firings.t_ns[i]);
    const Eigen::Vector3d in_world = pose.linear() * firings.direction[i];
    for (int k = 0; k < 3; ++k) {
      origin[k * n + i] = static_cast<float>(pose.translation()[k]);
      direction[k * n + i] = static_cast<float>(in_world[k]);
    }
  }
  const kernels::Rays all{static_cast<int>(n), origin, direction};
  RenderedRays rays = model.trace(backend, all);
  model.trace_actors(backend, all, firings.t_ns, motion.scene.actors, &rays);

  LidarScan scan;
  Rigid3d axes_from_sensor = Rigid3d::Identity();
  for (std::size_t i = 0; i < n; ++i) {
    if (i == 0 || firings.t_ns[i] != firings.t_ns[i - 1]) {
      const std::int64_t t_ns = firings.t_ns[i];
      if (options.axes == PointAxes::kWorld) axes_from_sensor = motion.world_from_sensor(t_ns);
      if (options.axes == PointAxes::kBody)
        axes_from_sensor =
            motion.world_from_body(t_ns).inverse(Eigen::Isometry) * motion.world_from_sensor(t_ns);
    }
    const double range_m = rays.depth[i];
    if (!(rays.opacity[i] >= kMinReturnOpacity && range_m > 0))
      ++scan.transparent;
    else if (!(range_m >= options.min_range_m && range_m <= options.max_range_m))
      ++scan.out_of_range;
    else
      scan.points.push_back({axes_from_sensor * (range_m * firings.direction[i]), firings.t_ns[i]});
  }
  return scan;
}

}  // namespace redrive
