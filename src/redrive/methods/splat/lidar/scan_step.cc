// SPDX-License-Identifier: Apache-2.0
// The part of a training step that renders a part of a LiDAR scan.
#include "redrive/methods/splat/lidar/scan_step.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/rng.h"
#include "redrive/methods/splat/image_windows.h"
#include "redrive/methods/splat/lidar/ray_raster.h"
#include "redrive/methods/splat/splat_model.h"

namespace redrive {
namespace {

/// Returns the times at which rays are fired at the keys of a raster: times rise evenly with the
/// azimuth, by least squares.
std::vector<std::int64_t> key_times(const RayGroup& group, std::span<const std::int64_t> t_ns,
                                    std::span<const float> key_azimuths) {
  const std::int64_t first_ns = t_ns[group.rays[0]];
  double azimuth = 0, time = 0, squares = 0, products = 0;
  for (std::size_t k = 0; k < group.rays.size(); ++k) {
    const double a = group.azimuth[k], t = double(t_ns[group.rays[k]] - first_ns);
    azimuth += a;
    time += t;
    squares += a * a;
    products += a * t;
  }
  const double n = static_cast<double>(group.rays.size()), spread = squares - azimuth * azimuth / n,
               slope = spread > 1e-9 * n ? (products - azimuth * time / n) / spread : 0;
  std::vector<std::int64_t> out;
  for (const float at : key_azimuths)
    out.push_back(first_ns + std::llround((time + slope * (n * double(at) - azimuth)) / n));
  return out;
}

}  // namespace

bool SplatModel::has_scan(const TrainingSet& data, const StepRequest& request) const {
  return rows_of_step(request.step) == SeenBy::kBoth && request.pixels == 0 &&
         !data.lidar.scan_ends.empty();
}

std::vector<std::vector<PlainPose>> SplatModel::actors_from_sensor(
    const std::vector<MovingObject>& actors, std::span<const std::int64_t> t_ns,
    const RayRaster& drawn) const {
  std::vector<std::vector<PlainPose>> out(actor_ids.size());
  for (std::size_t a = 0; a < actor_ids.size(); ++a) {
    const auto actor = std::ranges::find(actors, actor_ids[a], &MovingObject::id);
    if (actor == actors.end()) continue;
    for (std::size_t key = 0; key < t_ns.size(); ++key)
      if (const auto world_from_actor = actor->world_from_box(t_ns[key]))
        out[a].push_back(
            plain(world_from_actor->inverse(Eigen::Isometry) * drawn.world_from_key(key)));
    if (out[a].size() < t_ns.size()) out[a].clear();
  }
  return out;
}

void SplatModel::step_scan(kernels::Backend& backend, const TrainingSet& data,
                           const StepRequest& request, std::span<float> gradients,
                           ScanBuffers* buffers, StepSums* sums) const {
  if (!buffers->windows)
    buffers->windows.emplace(data.scene, data.lidar, [ids = actor_ids](std::int64_t id) {
      return std::ranges::find(ids, id) != ids.end();
    });
  const ScanWindows& windows = *buffers->windows;
  if (windows.size() == 0) return;
  const auto drawn =
      static_cast<std::uint64_t>(request.world_size * (request.step / scan_every) + request.rank);
  const ScanWindow window =
      windows[drawn_window(random_key(request.seed, kStreamScans), drawn, windows.size())];
  std::vector<MovingObject> moved = data.scene.actors;
  correct_actors(&moved);
  for (const RayGroup& group : group_around(window.rays(), window.world_from_axes)) {
    const RayRaster rays(group);
    const auto times = key_times(group, window.t_ns, rays.key_azimuths());
    const auto poses = actors_from_sensor(moved, times, rays);
    std::vector<kernels::GaussianPart> parts;
    for (std::size_t a = 0; a < poses.size(); ++a)
      parts.push_back({layout().first_block(a), poses[a]});
    const std::size_t plane = rays.size().plane();
    ScanTarget& target = buffers->target;
    target.log_range.assign(plane, kernels::kNoRange);
    target.intensity.assign(plane, 0);
    target.weight.assign(plane, 0);
    for (std::size_t k = 0; k < group.rays.size(); ++k) {
      const std::size_t place = rays.places()[k], ray = group.rays[k];
      target.log_range[place] = window.log_range[ray];
      target.intensity[place] = window.intensity[ray];
      target.weight[place] = 1 / static_cast<float>(window.t_ns.size());
    }
    kernels::RasterOptions options;
    options.log_range = target.log_range;
    kernels::Raster raster = backend.gaussians().rasterise(rays.camera(parts), all(), options);
    ScanGradient& gradient = buffers->gradient;
    const double loss = scan_loss(raster.image(), target, scan_weights, &gradient);
    sums->terms[kScanLoss] += scan_every * loss;
    if (!std::isfinite(loss)) return;
    buffers->error.assign(plane, 0);
    kernels::GaussianDerivatives to;
    kernels::GaussianUpdate update;
    if (request.update) {
      update = gaussian_update(*request.update, SeenBy::kLidar);
      to.update = &update;
    } else {
      to.gradients = gradients.first(blocks_size());
      to.errors = gradients.last(errors());
    }
    raster.backward({gradient.d_rgb, gradient.d_transmittance, buffers->error, gradient.d_range},
                    to, {});
  }
}

}  // namespace redrive
