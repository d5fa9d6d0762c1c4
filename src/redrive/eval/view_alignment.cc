// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/view_alignment.h"

#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/poses/pose_refiner.h"

namespace redrive {
namespace {

// A few hundred rays per image and step; the decaying learning rate averages their noise.
constexpr int kSteps = 80, kRaysOfView = 128;
constexpr double kFirstRate_m = 1e-2, kLastRate = 0.02;  // rate of a step; its factor at the end

View moved(View view, const Rigid3d& motion, bool held_out) {
  view.motion = view.motion.value_or(Rigid3d::Identity()) * motion;
  view.held_out = held_out;
  return view;
}

}  // namespace

ViewAlignment align_views(const Run& run, kernels::Backend& backend,
                          std::span<const std::size_t> views, const Exclusions& left_out,
                          Scene* scene) {
  REDRIVE_CHECK(!views.empty());
  // The sampler draws from training views, so these are marked as such.
  Scene turned = *scene;
  for (View& view : turned.views) view.held_out = true;
  std::vector<Image8> images(turned.views.size());
  for (const std::size_t v : views) {
    View& view = turned.views[v];
    view.held_out = false;
    images[v] = load_view(turned, view);
    apply_mask(view_mask(turned, view, left_out.masks[view.camera], left_out.moving), &images[v]);
  }
  PixelSampler sampler(turned, images, run.options.seed);

  const std::size_t numbers = 6 * turned.views.size();
  AdamMoments moments(numbers);
  std::vector<float> motions(numbers);
  std::vector<double> gradient(numbers);
  std::vector<float> unused(run.state.model->size());  // the field is frozen
  const int rays =
      static_cast<int>(std::min<std::size_t>(kRaysOfView * views.size(), kMaxAlignedRays));
  const LidarReturns no_lidar;
  const TrainingSet data{turned, images, no_lidar, sampler};
  StepBuffers buffers;
  StepRequest request;
  request.seed = run.options.seed;
  request.pixels = rays;
  request.pose_gradients = true;
  Progress progress("refining poses of held-out images", kSteps);
  for (int step = 0; step < kSteps; ++step, progress.count()) {
    request.step = step;
    const StepOutput output = run.state.model->step(backend, data, request, unused, &buffers);
    request.pixels_drawn += static_cast<std::uint64_t>(output.pixels);
    for (const std::size_t v : views) {
      const Vector6d six = in_body(turned, turned.views[v], output.views[v]);
      for (int k = 0; k < 6; ++k) gradient[6 * v + k] = six[k];
    }
    const PoseRates rates = pose_rates(kFirstRate_m * std::pow(kLastRate, step / (kSteps - 1.0)));
    update_poses(
        gradient,
        [&](std::size_t i) {
          return i % 6 < 3 ? rates.translation_rate_m : rates.rotation_rate_rad;
        },
        motions, &moments);
    for (const std::size_t v : views)
      turned.views[v] =
          moved(scene->views[v], rigid_from_vector(&motions[6 * v]), /*held_out=*/false);
    sampler.update_poses();
  }

  ViewAlignment alignment{static_cast<int>(views.size()), 0, 0};
  for (const std::size_t v : views) {
    scene->views[v] = moved(scene->views[v], rigid_from_vector(&motions[6 * v]), /*held_out=*/true);
    for (int k = 0; k < 3; ++k) {
      alignment.translation_m += double(motions[6 * v + k]) * motions[6 * v + k];
      alignment.rotation_deg += double(motions[6 * v + 3 + k]) * motions[6 * v + 3 + k];
    }
  }
  alignment.translation_m = std::sqrt(alignment.translation_m / alignment.views);
  alignment.rotation_deg = std::sqrt(alignment.rotation_deg / alignment.views) * 180 / M_PI;
  return alignment;
}

}  // namespace redrive
