// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/lidar_scan.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/rng.h"
#include "redrive/scene/lidar/lidar_rays.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {

Rigid3d SensorMotion::world_from_body(std::int64_t t_ns) const {
  return scene.world_from_body(t_ns);
}

Rigid3d SensorMotion::world_from_sensor(std::int64_t t_ns) const {
  return shifted_camera(scene.global_from_world, world_from_body(t_ns), body_from_sensor, axes,
                        shift_m);
}

namespace {

/// Rays in the world, and what the field renders along them.
struct TracedRays {
  LidarRays in_world;
  RenderedRays rendered;

  Eigen::Vector3d at(std::size_t i) const {
    return in_world.origin_at(i).cast<double>() +
           double(rendered.depth[i]) * in_world.direction_at(i).cast<double>();
  }
};

TracedRays trace(kernels::Backend& backend, const Field& model, const LidarFirings& firings,
                 const SensorMotion& motion) {
  TracedRays out;
  out.in_world = fire(
      firings.t_ns, [&](std::size_t i) { return firings.direction[i]; },
      [&](std::int64_t t_ns) { return motion.world_from_sensor(t_ns); }, &backend.pool());
  out.rendered = model.trace(
      backend,
      {static_cast<int>(firings.size()), out.in_world.origin, out.in_world.direction, firings.t_ns},
      motion.scene.actors);
  return out;
}

/// Returns the moving object that each ray meets: the one whose box holds the rendered point, if
/// the world alone would be met elsewhere.
std::vector<std::int32_t> met_actors(kernels::Backend& backend, const Field& model,
                                     const LidarFirings& firings, const SensorMotion& motion,
                                     const TracedRays& traced) {
  constexpr float kSame_m = 0.05f;
  const std::size_t n = firings.size();
  std::vector<std::int32_t> out(n, kNoActor);
  if (motion.scene.actors.empty()) return out;
  const MovingObjects objects(motion.scene.actors);
  std::vector<MovingBox> boxes;
  std::vector<std::size_t> in_box;
  for (std::size_t i = 0; i < n; ++i) {
    if (i == 0 || firings.t_ns[i] != firings.t_ns[i - 1]) boxes = objects.at(firings.t_ns[i]);
    const auto box = std::ranges::find_if(
        boxes, [&](const MovingBox& other) { return other.contains(traced.at(i)); });
    if (box == boxes.end()) continue;
    out[i] = static_cast<std::int32_t>(box->id);
    in_box.push_back(i);
  }
  std::vector<float> origin, direction;
  for (std::size_t k = 0; k < 3; ++k)
    for (const std::size_t i : in_box) {
      origin.push_back(traced.in_world.origin[k * n + i]);
      direction.push_back(traced.in_world.direction[k * n + i]);
    }
  const RenderedRays alone =
      model.trace(backend, {static_cast<int>(in_box.size()), origin, direction});
  for (std::size_t k = 0; k < in_box.size(); ++k)
    if (std::abs(alone.depth[k] - traced.rendered.depth[in_box[k]]) <= kSame_m)
      out[in_box[k]] = kNoActor;
  return out;
}

}  // namespace

LidarScan render_scan(kernels::Backend& backend, const Field& model, const LidarFirings& firings,
                      const SensorMotion& motion, const ScanOptions& options) {
  const TracedRays traced = trace(backend, model, firings, motion);
  const RenderedRays& rays = traced.rendered;
  const std::vector<std::int32_t> actors = met_actors(backend, model, firings, motion, traced);
  LidarScan scan;
  scan.has_intensity = !rays.intensity.empty();
  Rigid3d axes_from_sensor = Rigid3d::Identity();
  for (std::size_t i = 0; i < firings.size(); ++i) {
    const std::int64_t t_ns = firings.t_ns[i];
    if (i == 0 || t_ns != firings.t_ns[i - 1]) {
      if (options.axes == PointAxes::kWorld) axes_from_sensor = motion.world_from_sensor(t_ns);
      if (options.axes == PointAxes::kBody)
        axes_from_sensor =
            motion.world_from_body(t_ns).inverse(Eigen::Isometry) * motion.world_from_sensor(t_ns);
    }
    const Eigen::Vector3d& direction = firings.direction[i];
    const double range_m = rays.depth[i];
    const float probability = rays.returned(i);
    const float least = options.seed
                            ? random_unit(random_key(*options.seed, kStreamReturns,
                                                     static_cast<std::uint64_t>(firings.t_ns[0])),
                                          i)
                            : kMinReturnOpacity;
    if (!(probability >= least && probability > 0 && range_m > 0) ||
        options.blind.contains(motion.body_from_sensor.linear() * direction)) {
      ++scan.lost;
      continue;
    }
    if (!(range_m >= options.min_range_m && range_m <= options.max_range_m)) {
      ++scan.out_of_range;
      continue;
    }
    LidarRecord point{axes_from_sensor * (range_m * direction), t_ns};
    point.ring = firings.ring[i];
    const float gain = options.gain * gain_of_ring(options.beam_gains, point.ring);
    point.intensity = scan.has_intensity ? std::min(gain * rays.intensity[i], 1.0f) : 0;
    point.azimuth_rad = static_cast<float>(std::atan2(direction.y(), direction.x()));
    point.range_m = static_cast<float>(range_m);
    point.actor = actors[i];
    point.loss = 1 - probability;
    scan.points.push_back(point);
    scan.firing.push_back(static_cast<std::uint32_t>(i));
  }
  return scan;
}

Rigid3d camera_from_lidar_axes() {
  Rigid3d axes = Rigid3d::Identity();
  axes.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return axes;
}

}  // namespace redrive
