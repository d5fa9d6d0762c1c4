// SPDX-License-Identifier: Apache-2.0
// Changes by a step of method splat: Adam on the Gaussians, gains and tracks, then the number of
// Gaussians.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/methods/splat/surface_planes.h"
#include "redrive/optim/packed_moments.h"

namespace redrive {
namespace {

constexpr std::int64_t kFlattenEvery = 50;  // steps

}  // namespace

AdamStep SplatModel::adam_step_of(double learning_rate, std::int64_t step) const {
  AdamStep out = adam_step(learning_rate, step);
  out.beta2 = beta2;
  out.bias2 = static_cast<float>(1 / (1 - std::pow(double(beta2), static_cast<double>(step))));
  out.epsilon = epsilon;
  return out;
}

kernels::GaussianUpdate SplatModel::gaussian_update(const StepUpdate& at, SeenBy rows) const {
  kernels::GaussianUpdate update;
  update.rows = rows;
  update.step = adam_step_of(at.learning_rate, at.step);
  const auto set = [&](int first, int end, float factor) {
    std::fill(update.rates + first, update.rates + end,
              static_cast<float>(at.learning_rate) * factor);
  };
  set(kPositionRow, kLogScaleRow, position_rate);
  set(kLogScaleRow, kQuaternionRow, scale_rate);
  set(kQuaternionRow, kOpacityRow, rotation_rate);
  set(kOpacityRow, kColourRow, 1);
  set(kColourRow, kHarmonicsRow, colour_rate);
  set(kHarmonicsRow, kLidarRow, harmonics_rate);
  // Few rays tell them, so their rates fall as the square of the others'.
  const auto settled = static_cast<float>(at.learning_rate / initial_rate);
  set(kLidarRow, kReturnRow, intensity_rate * settled);
  set(kReturnRow, kDistanceRow, return_rate * settled);
  update.min_log_scale = std::log(min_scale);
  update.max_log_scale = std::log(max_scale);
  update.version = version_;
  update.numbers = at.parameters.first(blocks_size());
  update.moments = at.adam->packed;
  update.errors = at.adam->errors;
  // Colours of sides that images see only at a glance would leave [0, 1], and an edit may turn
  // these to the camera.
  update.bounded_colours = layout().world_blocks();
  return update;
}

void SplatModel::update(kernels::Backend& backend, double learning_rate, std::int64_t step,
                        std::span<float> gradients, AdamState* adam) {
  const std::span<float> others = parameters.span().subspan(blocks_size());
  if (gradients.size() == gradients_size(/*with_update=*/false))
    backend.gaussians().update_gaussians(
        gaussian_update({learning_rate, step, parameters, adam}, rows_of_step(step - 1)), all().n,
        gradients.first(blocks_size()), gradients.last(errors()));
  else
    REDRIVE_CHECK_OP(gradients.size(), ==, others.size());
  const std::span<float> of_others = others_of(gradients);
  for (std::size_t i = 0; i < gains.size(); ++i) others[i] += of_others[i];
  for (std::size_t a = 0; motion_rate > 0 && a < actor_ids.size(); ++a) {
    const auto [first, n] = motions_of(a);
    update_motions(adam_step_of(learning_rate, step),
                   static_cast<float>(learning_rate) * motion_rate, of_others.subspan(first, n),
                   others.subspan(first, n), adam->first_moment.span().subspan(first, n),
                   adam->second_moment.span().subspan(first, n));
  }
  std::ranges::fill(gradients, 0.0f);
}

std::uint64_t SplatModel::new_version() {
  static std::atomic<std::uint64_t> versions = 0;
  return ++versions;
}

void SplatModel::replace_parameters(Buffer<float> by) {
  Trainee::replace_parameters(std::move(by));
  renew_version();
}

void SplatModel::freeze() { renew_version(); }

void SplatModel::fetch(kernels::Backend& backend) const { backend.gaussians().fetch(); }

std::optional<std::size_t> SplatModel::bad_moment(std::span<const std::uint32_t> packed) const {
  for (std::size_t i = 0; i < packed.size(); ++i) {
    if (!std::isfinite(unpacked_first(packed[i])) || !std::isfinite(unpacked_second(packed[i])))
      return i;
  }
  return std::nullopt;
}

void SplatModel::finish_step(kernels::Backend& backend, const StepRequest& request,
                             const StepOutput&, std::int64_t step, const StepBuffers& buffers,
                             AdamState* adam) {
  filled = 0;
  if (const SurfacePlanes* const surfaces = surfaces_of(buffers);
      surfaces && step % kFlattenEvery == 0) {
    backend.gaussians().fetch();
    flatten_gaussians(*surfaces, surface_rate, static_cast<std::size_t>(gaussians),
                      parameters.data(), backend.pool());
    renew_version();
  }
  if (step % densify_every != 0 || request.progress >= double(densified_until)) return;
  const double grown = std::min(1.0, request.progress / double(grown_by));
  DensifyOptions options;
  const int most = most_gaussians() - most_fills();
  options.target =
      static_cast<std::size_t>(first_gaussians + grown * std::max(0, most - first_gaussians));
  options.min_opacity = min_opacity;
  options.replaced = grown < 1 ? replaced : 0;  // the last ones have time to settle
  std::vector<Eigen::Vector3f> bounds;
  for (std::size_t a = 0, i = blocks_size() + gains.size(); a < actor_ids.size(); ++a, i += 3)
    bounds.emplace_back(parameters[i], parameters[i + 1], parameters[i + 2]);
  options.actor_bounds = bounds;
  options.ahead_m = ahead_m();
  backend.gaussians().fetch();
  backend.gaussians().release();  // frees it before densify copies
  change_number(options, random_key(request.seed, kStreamDensify, static_cast<std::uint64_t>(step)),
                adam, backend.pool());
}

void SplatModel::change_number(const DensifyOptions& options, std::uint64_t key, AdamState* adam,
                               ThreadPool& pool) {
  GaussianLayout layout = this->layout();
  densify(options, key, &layout, &parameters, &adam->packed, &adam->errors, pool);
  gaussians = static_cast<int>(layout.world);
  actor_ends = std::move(layout.actor_ends);
  renew_version();
}

}  // namespace redrive
