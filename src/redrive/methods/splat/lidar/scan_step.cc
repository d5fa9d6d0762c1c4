// SPDX-License-Identifier: Apache-2.0
// Training on parts of LiDAR scans: before the first image, and in a step.
#include "redrive/methods/splat/lidar/scan_step.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/rng.h"
#include "redrive/methods/splat/image_windows.h"
#include "redrive/methods/splat/lidar/ray_raster.h"
#include "redrive/methods/splat/splat_model.h"

namespace redrive {
bool SplatModel::has_scan(const TrainingSet& data, const StepRequest& request) const {
  return rows_of_step(request.step) == SeenBy::kBoth && request.pixels == 0 &&
         !data.lidar.scan_ends.empty();
}

void SplatModel::step_scan(kernels::Backend& backend, const TrainingSet& data,
                           const StepRequest& request, std::uint64_t key, std::uint64_t draw,
                           std::span<float> gradients, ScanBuffers* buffers, StepSums* sums) const {
  if (!buffers->windows)
    buffers->windows.emplace(data.scene, data.lidar, [ids = actor_ids](std::int64_t id) {
      return std::ranges::find(ids, id) != ids.end();
    });
  const ScanWindows& windows = *buffers->windows;
  if (windows.size() == 0) return;
  const ScanWindow window = windows[drawn_window(key, draw, windows.size())];
  std::vector<MovingObject> moved = data.scene.actors;
  correct_actors(&moved);
  for (const RayGroup& group : group_around(window.rays(), window.world_from_axes)) {
    const RayRaster rays(group);
    const DrawnGaussians shown = drawn(seen_actors(moved, rays.key_poses(), rays.key_times()));
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
    kernels::Raster raster =
        backend.gaussians().rasterise(rays.camera(shown.parts), shown.gaussians, options);
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

bool SplatModel::train_first(kernels::Backend& backend, const TrainingSet& data, std::uint64_t seed,
                             AdamState* adam, const std::function<bool()>& go_on) {
  if (scan_every == 0 || data.lidar.scan_ends.empty()) return true;
  constexpr int kPartsAtOnce = 16;
  const std::uint64_t key = random_key(seed, kStreamScans, 1);
  ScanBuffers buffers;
  StepUpdate update{0, 0, parameters, adam};
  StepRequest request;
  request.update = &update;
  StepSums unused;
  for (int k = 0; k < scans_first; ++k) {
    if (k % kPartsAtOnce == 0 && !go_on()) return false;
    update.step = k + 1;
    update.learning_rate =
        learning_rate({.step = k, .progress = static_cast<double>(k) / scans_first});
    step_scan(backend, data, request, key, static_cast<std::uint64_t>(k), {}, &buffers, &unused);
  }
  fetch(backend);
  // Images begin with moments of their own.
  std::ranges::fill(adam->packed.span(), 0u);
  return true;
}

}  // namespace redrive
