// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/grid/grid_model.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Core>

#include "redrive/base/numbers.h"

namespace redrive {

namespace {

/// Returns one ray for each group: the mean of its rays, wide enough to cover all of them.
RayBatch mean_rays_of_groups(const RayBatch& batch) {
  RayBatch out;
  out.n = static_cast<int>(batch.group.size()) - 1;
  const std::size_t groups = out.n, rays = batch.n;
  out.origin.resize(3 * groups);
  out.direction.resize(3 * groups);
  out.pixel_angle.resize(groups);
  for (std::size_t g = 0; g < groups; ++g) {
    const std::uint32_t first = batch.group[g], last = batch.group[g + 1];
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    for (std::uint32_t ray = first; ray < last; ++ray)
      for (int k = 0; k < 3; ++k) sum[k] += batch.direction[k * rays + ray];
    sum.normalize();
    for (int k = 0; k < 3; ++k) {
      out.origin[k * groups + g] = batch.origin[k * rays + first];
      out.direction[k * groups + g] = sum[k];
    }
    out.pixel_angle[g] = batch.pixel_angle[first] * std::sqrt(static_cast<float>(last - first));
  }
  return out;
}

/// Returns the index of each ray's group.
std::vector<std::uint32_t> groups_of_rays(std::span<const std::uint32_t> group) {
  std::vector<std::uint32_t> out(group.back());
  for (std::uint32_t g = 0; g + 1 < group.size(); ++g)
    std::fill(out.begin() + group[g], out.begin() + group[g + 1], g);
  return out;
}

}  // namespace

/// RNG keys of a step: for the three iterations of sampling, and for the inactive rays that are
/// kept.
struct GridModel::StepKeys {
  std::array<std::uint64_t, 3> of_iteration;
  std::uint64_t of_compaction;

  StepKeys(std::uint64_t seed, std::uint64_t stream, std::int64_t step, const RayBatch& batch) {
    const auto first = 4 * static_cast<std::uint64_t>(step);
    const auto key = [&](int k) {
      return advance_key(random_key(seed, stream, first + k), batch.first_ray);
    };
    for (int round = 0; round < 3; ++round) of_iteration[round] = key(round);
    of_compaction = key(3);
  }
};

struct GridModel::RayBundle {
  kernels::Rays rays;
  std::span<const float> pixel_angle;

  RayBundle() = default;
  explicit RayBundle(const RayBatch& batch)
      : rays(rays_of(batch)), pixel_angle(std::span(batch.pixel_angle).first(batch.n)) {}
};

/// Intervals of one iteration of sampling, with their positions in the unit cube.
struct GridModel::IntervalSamples {
  kernels::Intervals intervals;
  kernels::UnitPoints points;
  std::span<float> density, weights;
};

/// Data of a forward pass: for all rays, and for the active ones, on which the field is evaluated.
struct GridModel::ForwardPass {
  RayBundle all;
  IntervalSamples proposal[2];
  kernels::Intervals intervals;  ///< the field's
  std::span<const float> background, gains;
  std::span<const Exposure> exposure;  ///< empty: no gains

  RayBundle active;
  std::span<const std::uint32_t>
      active_rays;  ///< indices among all rays, ascending; empty: all are active
  IntervalSamples field;
  kernels::Samples samples;
  std::span<const float> active_background;
  std::span<float> features, harmonics, raw;

  /// Gathers the active rays' part of `from`, which has `each` numbers per ray.
  std::span<const float> gather_active(kernels::GridStages& stages, kernels::RayLayout layout,
                                       int each, std::span<const float> from,
                                       Workspace* workspace) const {
    if (active_rays.empty()) return from;
    const auto out = workspace->take(active_rays.size() * each);
    stages.gather_rays(active_rays, layout, from, out);
    return out;
  }
  /// Returns a buffer for numbers of active rays that scatter_to_all() writes to `all`.
  std::span<float> active_buffer(std::span<float> all, int each, Workspace* workspace) const {
    return active_rays.empty() ? all : workspace->take(active_rays.size() * each);
  }
  void scatter_to_all(kernels::GridStages& stages, kernels::RayLayout layout,
                      std::span<const float> from, std::span<const float> elsewhere,
                      std::span<float> all) const {
    if (!active_rays.empty()) stages.scatter_rays(active_rays, layout, from, elsewhere, all);
  }
};

GridModel::IntervalSamples GridModel::contract_intervals(kernels::Backend& backend,
                                                         const RayBundle& bundle, int per_ray,
                                                         std::span<const float> edges,
                                                         float min_footprint,
                                                         Workspace* workspace) const {
  const std::size_t count = static_cast<std::size_t>(bundle.rays.n) * per_ray;
  const auto position = workspace->take(3 * count), footprint = workspace->take(count);
  IntervalSamples round;
  round.intervals = {per_ray, edges};
  backend.grid().contract(contraction, bundle.rays, bundle.pixel_angle, round.intervals,
                          min_footprint, position, footprint);
  round.points = {count, position, footprint};
  return round;
}

void GridModel::evaluate_sky(kernels::Backend& backend, const RayBatch& batch, ForwardPass* pass,
                             Workspace* workspace) const {
  if (sky.n_levels == 0 && !batch.background.empty()) {
    pass->background = batch.background;
    return;
  }
  const auto colour = workspace->take(3 * static_cast<std::size_t>(batch.n));
  pass->background = colour;
  if (sky.n_levels == 0)
    std::ranges::fill(colour, background);
  else
    backend.grid().sky(grid(kSkyGrid), pass->all.rays, pass->all.pixel_angle, colour);
}

GridModel::ForwardPass GridModel::sample_proposals(kernels::Backend& backend, const RayBatch& batch,
                                                   const StepKeys* keys,
                                                   Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const bool jitter = keys != nullptr;
  const auto key = [&](int round) { return keys ? keys->of_iteration[round] : 0; };
  const auto edges_for = [&](int n, int per_ray) {
    return workspace->take(static_cast<std::size_t>(n) * (per_ray + 1));
  };
  const auto draw_edges = [&](int n, const IntervalSamples& from, int per_ray, int round) {
    const auto edges = edges_for(n, per_ray);
    stages.sample_pdf(n, from.intervals, from.weights,
                      {per_ray, histogram_padding, jitter, key(round)}, edges);
    return edges;
  };
  const auto evaluate_proposal = [&](const RayBundle& bundle, int per_ray,
                                     std::span<const float> edges) {
    IntervalSamples round =
        contract_intervals(backend, bundle, per_ray, edges, min_proposal_footprint, workspace);
    round.density = workspace->take(round.points.n);
    round.weights = workspace->take(round.points.n);
    stages.proposal_density(grid(kProposalGrid), density_scale(), round.points, round.density);
    stages.weights(bundle.rays.n, round.intervals, round.density, round.weights);
    return round;
  };
  const auto [coarse, fine] = proposal_samples;
  ForwardPass pass;
  pass.all = RayBundle(batch);
  const bool grouped = !batch.group.empty();
  const RayBatch mean_rays = grouped ? mean_rays_of_groups(batch) : RayBatch();
  const RayBundle first = grouped ? RayBundle(mean_rays) : pass.all;
  const auto uniform = edges_for(first.rays.n, coarse);
  stages.sample_uniform(first.rays, {coarse, spacing, contraction, jitter, key(0)}, uniform);
  pass.proposal[0] = evaluate_proposal(first, coarse, uniform);
  auto edges = draw_edges(first.rays.n, pass.proposal[0], fine, 1);
  if (grouped) {
    const auto group_edges = edges;
    edges = edges_for(batch.n, fine);
    stages.gather_rays(groups_of_rays(batch.group), kernels::RayLayout::kRows, group_edges, edges);
  }
  pass.proposal[1] = evaluate_proposal(pass.all, fine, edges);
  pass.intervals = {samples, draw_edges(batch.n, pass.proposal[1], samples, 2)};
  return pass;
}

void GridModel::compact_batch(kernels::Backend& backend, const StepKeys* keys, ForwardPass* pass,
                              Workspace* workspace) const {
  using kernels::RayLayout;
  kernels::GridStages& stages = backend.grid();
  const RayBundle& all = pass->all;
  const IntervalSamples& round = pass->proposal[1];
  kernels::RayCompaction how{min_active_opacity};
  if (keys) how = {min_active_opacity, keep_probability, keys->of_compaction};
  const auto list = workspace->take<std::uint32_t>(all.rays.n);
  const int n = stages.compact_rays(all.rays.n, round.intervals.per_ray, round.weights, how, list);
  if (n < all.rays.n) pass->active_rays = list.first(n);
  const auto gather_active = [&](RayLayout layout, int each, std::span<const float> from) {
    return pass->gather_active(stages, layout, each, from, workspace);
  };
  pass->active.rays = {n, gather_active(RayLayout::kColumns, 3, all.rays.origin),
                       gather_active(RayLayout::kColumns, 3, all.rays.direction)};
  pass->active.pixel_angle = gather_active(RayLayout::kRows, 1, all.pixel_angle);
  pass->field.intervals = {samples,
                           gather_active(RayLayout::kRows, samples + 1, pass->intervals.edges)};
  pass->active_background = gather_active(RayLayout::kColumns, 3, pass->background);
}

void GridModel::sample(kernels::Backend& backend, ForwardPass* pass, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const int active = pass->active.rays.n;
  const std::size_t count = static_cast<std::size_t>(active) * samples;
  pass->field =
      contract_intervals(backend, pass->active, samples, pass->field.intervals.edges, 0, workspace);
  pass->features = workspace->take(count * field.grid.outputs());
  pass->harmonics = workspace->take(static_cast<std::size_t>(active) * kHarmonics);
  pass->raw = workspace->take(4 * count);
  stages.encode(grid(kFieldGrid), pass->field.points, pass->features);
  stages.harmonics(pass->active.rays, pass->harmonics);
  stages.network_forward(network(), active, samples, pass->features, pass->harmonics, pass->raw);
}

GridModel::ForwardPass GridModel::forward(kernels::Backend& backend, const RayBatch& batch,
                                          const StepKeys* keys, const kernels::CompositeOut& out,
                                          Workspace* workspace) const {
  using kernels::RayLayout;
  kernels::GridStages& stages = backend.grid();
  ForwardPass pass = sample_proposals(backend, batch, keys, workspace);
  evaluate_sky(backend, batch, &pass, workspace);
  compact_batch(backend, keys, &pass, workspace);
  sample(backend, &pass, workspace);
  const int active = pass.active.rays.n;
  const std::size_t count = static_cast<std::size_t>(active) * samples;
  const auto t = workspace->take(count), dt = workspace->take(count);
  stages.midpoints(active, pass.field.intervals, t, dt);
  pass.samples = {samples, t, dt};
  const kernels::CompositeOut active_out = {pass.active_buffer(out.rgb, 3, workspace),
                                            pass.active_buffer(out.depth, 1, workspace),
                                            pass.active_buffer(out.opacity, 1, workspace),
                                            pass.active_buffer(out.weights, samples, workspace)};
  backend.composite_forward(active, pass.samples, pass.raw, pass.active_background, active_out);
  pass.scatter_to_all(stages, RayLayout::kColumns, active_out.rgb, pass.background, out.rgb);
  pass.scatter_to_all(stages, RayLayout::kRows, active_out.depth, {}, out.depth);
  pass.scatter_to_all(stages, RayLayout::kRows, active_out.opacity, {}, out.opacity);
  pass.scatter_to_all(stages, RayLayout::kRows, active_out.weights, {}, out.weights);
  if (appearance.size() > 0 && !batch.exposure.empty()) {
    pass.exposure = batch.exposure;
    const auto gains = workspace->take(out.rgb.size());
    stages.apply_exposure({appearance, part(kAppearance)}, pass.exposure, gains, out.rgb);
    pass.gains = gains;
  }
  return pass;
}

void GridModel::render_rays(kernels::Backend& backend, const RayBatch& batch,
                            const kernels::CompositeOut& out, Workspace* workspace) const {
  const std::size_t rays = batch.n;
  workspace->begin();
  const auto weights = workspace->take(rays * samples);
  const ForwardPass pass =
      forward(backend, batch, nullptr, {out.rgb, out.depth, out.opacity, weights}, workspace);
  backend.grid().median_depth(batch.n, pass.intervals, weights, out.opacity, out.depth);
}

RayGradientsOutput GridModel::gradients(kernels::Backend& backend, const RayBatch& batch,
                                        std::uint64_t seed, std::int64_t step,
                                        std::span<float> gradients, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const std::size_t rays = batch.n;
  workspace->begin();
  const auto rgb = workspace->take(3 * rays), depth = workspace->take(rays),
             opacity = workspace->take(rays), weights = workspace->take(rays * samples),
             d_rgb = workspace->take(3 * rays), squares = workspace->set_aside(rays);
  const kernels::CompositeOut out{rgb, depth, opacity, weights};
  const StepKeys keys(seed, kStreamSamples, step, batch);
  const ForwardPass pass = forward(backend, batch, &keys, out, workspace);

  RayGradientsOutput losses;
  losses.active_rays = pass.active.rays.n;
  StepSums& sums = workspace->sums();
  sums.opacity = mean_of(opacity);
  const auto target = std::span(batch.target).first(3 * rays);
  backend.photometric_loss(rgb, target, d_rgb, &sums.rgb_mse);
  stages.huber_loss({{appearance, part(kAppearance)},
                     pass.exposure,
                     rgb,
                     pass.gains,
                     target,
                     batch.weight,
                     huber_delta},
                    d_rgb, squares, part_of(gradients, kAppearance), &sums.terms[kColourLoss]);
  if (batch.error_map_rays > 0) sums.rgb_mse = mean_of(squares.first(rays - batch.error_map_rays));
  losses.squared_errors = squares;

  const auto d_raw = workspace->take(pass.raw.size()),
             d_field = workspace->take(batch.refines ? 3 * pass.field.points.n : 0);
  losses.d_origin.resize(batch.refines ? 3 * rays : 0);
  losses.d_direction.resize(losses.d_origin.size());
  const auto d_active_rgb =
      pass.gather_active(stages, kernels::RayLayout::kColumns, 3, d_rgb, workspace);
  backend.composite_backward(losses.active_rays, pass.samples, pass.raw, pass.active_background,
                             {d_active_rgb, {}}, d_raw);
  if (sparsity_weight > 0) {  // the active rays' part of the mean over all rays
    const std::size_t points = pass.field.points.n;
    const float part =
        sparsity_weight * static_cast<float>(losses.active_rays) / static_cast<float>(rays);
    stages.sparsity_loss(losses.active_rays, pass.field.intervals, pass.raw.last(points), part,
                         d_raw.last(points), &sums.terms[kSparsityLoss]);
  }
  backward_field(backend, pass, d_raw, gradients, d_field, workspace);
  if (batch.refines)
    backward_rays(backend, pass, d_field, losses.d_origin, losses.d_direction, workspace);
  if (sky.n_levels > 0)
    stages.sky_backward(grid(kSkyGrid), pass.all.rays, pass.all.pixel_angle, pass.background,
                        opacity, d_rgb, part_of(gradients, kSkyGrid), losses.d_direction);
  backward_proposals(backend, pass, weights, gradients,
                     std::span(sums.terms).subspan(kProposalLoss, 2), workspace);
  return losses;
}

void GridModel::range_gradients(kernels::Backend& backend, const RayBatch& batch,
                                std::uint64_t seed, std::int64_t step, std::span<float> gradients,
                                Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const std::size_t rays = batch.n, count = rays * samples;
  workspace->begin();
  const StepKeys keys(seed, kStreamLidarSamples, step, batch);
  ForwardPass pass = sample_proposals(backend, batch, &keys, workspace);
  pass.active = pass.all;  // every LiDAR ray has hit a surface
  pass.field.intervals = pass.intervals;
  sample(backend, &pass, workspace);
  const auto density = pass.raw.subspan(3 * count), weights = workspace->take(count),
             d_weights = workspace->take(count), d_raw = workspace->take(4 * count);
  stages.weights(batch.n, pass.intervals, density, weights);
  const float spread_m = std::max(
      last_range_spread_m,
      first_range_spread_m * std::exp2(-static_cast<float>(step) / range_spread_half_life));
  stages.range_loss(batch.n, pass.intervals, weights, batch.range_m, spread_m, range_weight,
                    d_weights, &workspace->sums().terms[kLidarLoss]);
  std::ranges::fill(d_raw.first(3 * count), 0.0f);  // the loss does not depend on colours
  stages.weights_backward(batch.n, pass.intervals, density, weights, d_weights,
                          d_raw.subspan(3 * count));
  backward_field(backend, pass, d_raw, gradients, {}, workspace);
  backward_proposals(backend, pass, weights, gradients, workspace->take<double>(2), workspace);
}

void GridModel::backward_field(kernels::Backend& backend, const ForwardPass& pass,
                               std::span<const float> d_raw, std::span<float> gradients,
                               std::span<float> d_position, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const auto d_features = workspace->take(pass.features.size());
  stages.network_backward(network(), pass.active.rays.n, samples, pass.features, pass.harmonics,
                          d_raw, part_of(gradients, kNetwork), d_features);
  stages.encode_backward(grid(kFieldGrid), pass.field.points, d_features,
                         part_of(gradients, kFieldGrid), d_position);
}

void GridModel::backward_rays(kernels::Backend& backend, const ForwardPass& pass,
                              std::span<const float> d_position, std::span<float> d_origin,
                              std::span<float> d_direction, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const auto d_active_origin = pass.active_buffer(d_origin, 3, workspace),
             d_active_direction = pass.active_buffer(d_direction, 3, workspace);
  stages.contract_backward(contraction, pass.active.rays, pass.field.intervals, d_position,
                           d_active_origin, d_active_direction);
  pass.scatter_to_all(stages, kernels::RayLayout::kColumns, d_active_origin, {}, d_origin);
  pass.scatter_to_all(stages, kernels::RayLayout::kColumns, d_active_direction, {}, d_direction);
}

/// Trains the proposals on the first part of the batch, which is drawn uniformly if at least a
/// quarter of it is. They need fewer rays, since they have fewer parameters than the field.
void GridModel::backward_proposals(kernels::Backend& backend, const ForwardPass& pass,
                                   std::span<const float> weights, std::span<float> gradients,
                                   std::span<double> losses, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const int trained = std::max(1, pass.all.rays.n / rays_per_proposal_ray);
  const auto of_trained = [&](const kernels::Intervals& all) {
    return kernels::Intervals{
        all.per_ray, all.edges.first(static_cast<std::size_t>(trained) * (all.per_ray + 1))};
  };
  for (std::size_t i = 0; i < losses.size(); ++i) {
    const IntervalSamples& round = pass.proposal[i];
    const std::size_t count = static_cast<std::size_t>(trained) * round.intervals.per_ray;
    const kernels::Intervals intervals = of_trained(round.intervals);
    const auto density = round.density.first(count), found = round.weights.first(count),
               d_found = workspace->take(count), d_density = workspace->take(count);
    stages.proposal_loss(trained, of_trained(pass.intervals),
                         weights.first(static_cast<std::size_t>(trained) * samples), intervals,
                         found, proposal_opacity_weight, d_found, &losses[i]);
    stages.weights_backward(trained, intervals, density, found, d_found, d_density);
    stages.proposal_density_backward(grid(kProposalGrid), round.points.first(count), density,
                                     d_density, part_of(gradients, kProposalGrid));
  }
}

}  // namespace redrive
