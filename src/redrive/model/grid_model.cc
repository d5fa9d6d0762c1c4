// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/grid_model.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Core>

namespace redrive {

namespace {

/// One ray for each group: the middle of its rays, as wide as they are together.
RayBatch middles_of_groups(const RayBatch& batch) {
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

/// For each ray the number of its group.
std::vector<std::uint32_t> groups_of_rays(std::span<const std::uint32_t> group) {
  std::vector<std::uint32_t> out(group.back());
  for (std::uint32_t g = 0; g + 1 < group.size(); ++g)
    std::fill(out.begin() + group[g], out.begin() + group[g + 1], g);
  return out;
}

}  // namespace

/// Of a step: of the three rounds of sampling, and of which empty rays are looked at all the same.
struct GridModel::Chance {
  std::array<std::uint64_t, 3> of_round;
  std::uint64_t of_empty;

  Chance(std::uint64_t seed, std::uint64_t stream, std::int64_t step, const RayBatch& batch) {
    const auto first = 4 * static_cast<std::uint64_t>(step);
    const auto key = [&](int k) {
      return advance_key(random_key(seed, stream, first + k), batch.first_ray);
    };
    for (int round = 0; round < 3; ++round) of_round[round] = key(round);
    of_empty = key(3);
  }
};

/// Rays where the backend reads them.
struct GridModel::Beams {
  kernels::Rays rays;
  std::span<const float> pixel_angle;

  Beams() = default;
  Beams(const RayBatch& batch, Workspace* workspace)
      : rays(upload_rays(batch, workspace)),
        pixel_angle(workspace->put(std::span(batch.pixel_angle).first(batch.n))) {}
};

/// Intervals of one round with their points.
struct GridModel::Round {
  kernels::Intervals intervals;
  kernels::UnitPoints points;
  std::span<float> density, weights;
};

/// Of all rays, but for what the field is asked for: of the live ones, those that are not empty.
struct GridModel::Pass {
  Beams all;
  Round proposal[2];
  kernels::Intervals intervals;  ///< the field's
  std::span<const float> background, gains;
  std::span<const Exposure> exposure;  ///< empty: no gains

  Beams live;
  std::span<const std::uint32_t> live_rays;  ///< of all, ascending; empty: they all are
  Round field;
  kernels::Samples samples;
  std::span<const float> background_of_live;
  std::span<float> features, harmonics, raw;

  /// What live rays have of `from`, `each` numbers of all rays.
  std::span<const float> of_live(kernels::GridStages& stages, kernels::RayLayout layout, int each,
                                 std::span<const float> from, Workspace* workspace) const {
    if (live_rays.empty()) return from;
    const auto out = workspace->take(live_rays.size() * each);
    stages.gather_rays(live_rays, layout, from, out);
    return out;
  }
  /// Room for the numbers of live rays that to_all() brings to `all`.
  std::span<float> room_of_live(std::span<float> all, int each, Workspace* workspace) const {
    return live_rays.empty() ? all : workspace->take(live_rays.size() * each);
  }
  void to_all(kernels::GridStages& stages, kernels::RayLayout layout, std::span<const float> from,
              std::span<const float> elsewhere, std::span<float> all) const {
    if (!live_rays.empty()) stages.scatter_rays(live_rays, layout, from, elsewhere, all);
  }
};

GridModel::Round GridModel::place(kernels::Backend& backend, const Beams& beams, int per_ray,
                                  std::span<const float> edges, float least_width,
                                  Workspace* workspace) const {
  const std::size_t count = static_cast<std::size_t>(beams.rays.n) * per_ray;
  const auto position = workspace->take(3 * count), footprint = workspace->take(count);
  Round round;
  round.intervals = {per_ray, edges};
  backend.grid().contract(contraction, beams.rays, beams.pixel_angle, round.intervals, least_width,
                          position, footprint);
  round.points = {count, position, footprint};
  return round;
}

void GridModel::evaluate_sky(kernels::Backend& backend, const RayBatch& batch, Pass* pass,
                             Workspace* workspace) const {
  if (sky.levels == 0 && !batch.background.empty()) {
    pass->background = workspace->put(batch.background);
    return;
  }
  const auto colour = workspace->take(3 * static_cast<std::size_t>(batch.n));
  pass->background = colour;
  if (sky.levels == 0)
    backend.fill(colour, background);
  else
    backend.grid().sky(grid(kSkyGrid), pass->all.rays, pass->all.pixel_angle, colour);
}

GridModel::Pass GridModel::propose(kernels::Backend& backend, const RayBatch& batch,
                                   const Chance* chance, Workspace* workspace) const {
  kernels::make_resident(backend, parameters);
  kernels::GridStages& stages = backend.grid();
  const bool jitter = chance != nullptr;
  const auto key = [&](int round) { return chance ? chance->of_round[round] : 0; };
  const auto edges_for = [&](int n, int per_ray) {
    return workspace->take(static_cast<std::size_t>(n) * (per_ray + 1));
  };
  const auto draw = [&](int n, const Round& from, int per_ray, int round) {
    const auto edges = edges_for(n, per_ray);
    stages.sample_pdf(n, from.intervals, from.weights,
                      {per_ray, histogram_padding, jitter, key(round)}, edges);
    return edges;
  };
  const auto look = [&](const Beams& beams, int per_ray, std::span<const float> edges) {
    Round round = place(backend, beams, per_ray, edges, min_proposal_footprint, workspace);
    round.density = workspace->take(round.points.n);
    round.weights = workspace->take(round.points.n);
    stages.proposal_density(grid(kProposalGrid), density_scale(), round.points, round.density);
    stages.weights(beams.rays.n, round.intervals, round.density, round.weights);
    return round;
  };
  const auto [coarse, fine] = proposal_samples;
  Pass pass;
  pass.all = Beams(batch, workspace);
  const bool grouped = !batch.group.empty();
  const RayBatch middles = grouped ? middles_of_groups(batch) : RayBatch();
  const Beams first = grouped ? Beams(middles, workspace) : pass.all;
  const auto spaced = edges_for(first.rays.n, coarse);
  stages.sample_uniform(first.rays, {coarse, spacing, contraction, jitter, key(0)}, spaced);
  pass.proposal[0] = look(first, coarse, spaced);
  auto edges = draw(first.rays.n, pass.proposal[0], fine, 1);
  if (grouped) {
    const std::vector<std::uint32_t> group = groups_of_rays(batch.group);
    const auto of_groups = edges;
    edges = edges_for(batch.n, fine);
    stages.gather_rays(workspace->put(group), kernels::RayLayout::kRows, of_groups, edges);
  }
  pass.proposal[1] = look(pass.all, fine, edges);
  pass.intervals = {samples, draw(batch.n, pass.proposal[1], samples, 2)};
  return pass;
}

void GridModel::find_live(kernels::Backend& backend, const Chance* chance, Pass* pass,
                          Workspace* workspace) const {
  using kernels::RayLayout;
  kernels::GridStages& stages = backend.grid();
  const Beams& all = pass->all;
  const Round& round = pass->proposal[1];
  kernels::RayCompaction how{min_active_opacity};
  if (chance) how = {min_active_opacity, keep_probability, chance->of_empty};
  const auto list = workspace->take<std::uint32_t>(all.rays.n);
  const int n = stages.compact_rays(all.rays.n, round.intervals.per_ray, round.weights, how, list);
  if (n < all.rays.n) pass->live_rays = list.first(n);
  const auto of_live = [&](RayLayout layout, int each, std::span<const float> from) {
    return pass->of_live(stages, layout, each, from, workspace);
  };
  pass->live.rays = {n, of_live(RayLayout::kColumns, 3, all.rays.origin),
                     of_live(RayLayout::kColumns, 3, all.rays.direction)};
  pass->live.pixel_angle = of_live(RayLayout::kRows, 1, all.pixel_angle);
  pass->field.intervals = {samples, of_live(RayLayout::kRows, samples + 1, pass->intervals.edges)};
  pass->background_of_live = of_live(RayLayout::kColumns, 3, pass->background);
}

void GridModel::sample(kernels::Backend& backend, Pass* pass, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const int live = pass->live.rays.n;
  const std::size_t count = static_cast<std::size_t>(live) * samples;
  pass->field = place(backend, pass->live, samples, pass->field.intervals.edges, 0, workspace);
  pass->features = workspace->take(count * field.grid.outputs());
  pass->harmonics = workspace->take(static_cast<std::size_t>(live) * kHarmonics);
  pass->raw = workspace->take(4 * count);
  stages.encode(grid(kFieldGrid), pass->field.points, pass->features);
  stages.harmonics(pass->live.rays, pass->harmonics);
  stages.network_forward(network(), live, samples, pass->features, pass->harmonics, pass->raw);
}

GridModel::Pass GridModel::forward(kernels::Backend& backend, const RayBatch& batch,
                                   const Chance* chance, const kernels::CompositeOut& out,
                                   Workspace* workspace) const {
  using kernels::RayLayout;
  kernels::GridStages& stages = backend.grid();
  Pass pass = propose(backend, batch, chance, workspace);
  evaluate_sky(backend, batch, &pass, workspace);
  find_live(backend, chance, &pass, workspace);
  sample(backend, &pass, workspace);
  const int live = pass.live.rays.n;
  const std::size_t count = static_cast<std::size_t>(live) * samples;
  const auto t = workspace->take(count), dt = workspace->take(count);
  stages.midpoints(live, pass.field.intervals, t, dt);
  pass.samples = {samples, t, dt};
  const kernels::CompositeOut seen = {pass.room_of_live(out.rgb, 3, workspace),
                                      pass.room_of_live(out.depth, 1, workspace),
                                      pass.room_of_live(out.opacity, 1, workspace),
                                      pass.room_of_live(out.weights, samples, workspace)};
  backend.composite_forward(live, pass.samples, pass.raw, pass.background_of_live, seen);
  pass.to_all(stages, RayLayout::kColumns, seen.rgb, pass.background, out.rgb);
  pass.to_all(stages, RayLayout::kRows, seen.depth, {}, out.depth);
  pass.to_all(stages, RayLayout::kRows, seen.opacity, {}, out.opacity);
  pass.to_all(stages, RayLayout::kRows, seen.weights, {}, out.weights);
  if (appearance.size() > 0 && !batch.exposure.empty()) {
    pass.exposure = workspace->put(batch.exposure);
    const auto gains = workspace->take(out.rgb.size());
    stages.apply_exposure({appearance, part(kAppearance)}, pass.exposure, gains, out.rgb);
    pass.gains = gains;
  }
  return pass;
}

void GridModel::render_rays(kernels::Backend& backend, const RayBatch& batch,
                            const kernels::CompositeOut& out, Workspace* workspace) const {
  const std::size_t rays = batch.n;
  workspace->begin(backend);
  const auto rgb = workspace->take(3 * rays), depth = workspace->take(rays),
             opacity = workspace->take(rays), weights = workspace->take(rays * samples);
  const Pass pass = forward(backend, batch, nullptr, {rgb, depth, opacity, weights}, workspace);
  backend.grid().median_depth(batch.n, pass.intervals, weights, opacity, depth);
  workspace->get(rgb, out.rgb);
  workspace->get(depth, out.depth);
  workspace->get(opacity, out.opacity);
}

RayGradientsOutput GridModel::gradients(kernels::Backend& backend, const RayBatch& batch,
                                        std::uint64_t seed, std::int64_t step,
                                        std::span<float> gradients, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const std::size_t rays = batch.n;
  workspace->begin(backend);
  const auto rgb = workspace->take(3 * rays), depth = workspace->take(rays),
             opacity = workspace->take(rays), weights = workspace->take(rays * samples),
             d_rgb = workspace->take(3 * rays), squares = workspace->set_aside(rays);
  const kernels::CompositeOut out{rgb, depth, opacity, weights};
  const Chance chance(seed, kStreamSamples, step, batch);
  const Pass pass = forward(backend, batch, &chance, out, workspace);

  RayGradientsOutput losses;
  losses.active_rays = pass.live.rays.n;
  StepSums& sums = workspace->sums();
  backend.mean(opacity, &sums.opacity);
  const auto target = workspace->put(std::span(batch.target).first(3 * rays)),
             weight = workspace->put(batch.weight);
  backend.photometric_loss(rgb, target, d_rgb, &sums.rgb_mse);
  stages.huber_loss({{appearance, part(kAppearance)},
                     pass.exposure,
                     rgb,
                     pass.gains,
                     target,
                     weight,
                     huber_delta},
                    d_rgb, squares, part_of(gradients, kAppearance), &sums.terms[kColourLoss]);
  if (batch.error_map_rays > 0)
    backend.mean(squares.first(rays - batch.error_map_rays), &sums.rgb_mse);
  losses.squared_errors = squares;

  const auto d_raw = workspace->take(pass.raw.size()),
             d_field = workspace->take(batch.refines ? 3 * pass.field.points.n : 0),
             d_origin = workspace->take(batch.refines ? 3 * rays : 0),
             d_direction = workspace->take(batch.refines ? 3 * rays : 0);
  const auto d_seen = pass.of_live(stages, kernels::RayLayout::kColumns, 3, d_rgb, workspace);
  backend.composite_backward(losses.active_rays, pass.samples, pass.raw, pass.background_of_live,
                             {d_seen, {}}, d_raw);
  if (sparsity_weight >
      0) {  // of the mean over all rays the live ones' part: the others have nothing to lose
    const std::size_t points = pass.field.points.n;
    const float part =
        sparsity_weight * static_cast<float>(losses.active_rays) / static_cast<float>(rays);
    stages.sparsity_loss(losses.active_rays, pass.field.intervals, pass.raw.last(points), part,
                         d_raw.last(points), &sums.terms[kSparsityLoss]);
  }
  backward_field(backend, pass, d_raw, gradients, d_field, workspace);
  if (batch.refines) backward_rays(backend, pass, d_field, d_origin, d_direction, workspace);
  if (sky.levels > 0)
    stages.sky_backward(grid(kSkyGrid), pass.all.rays, pass.all.pixel_angle, pass.background,
                        opacity, d_rgb, part_of(gradients, kSkyGrid), d_direction);
  losses.d_origin.resize(d_origin.size());
  losses.d_direction.resize(d_direction.size());
  workspace->get(d_origin, losses.d_origin);
  workspace->get(d_direction, losses.d_direction);
  backward_proposals(backend, pass, weights, gradients,
                     std::span(sums.terms).subspan(kProposalLoss, 2), workspace);
  return losses;
}

void GridModel::range_gradients(kernels::Backend& backend, const RayBatch& batch,
                                std::uint64_t seed, std::int64_t step, std::span<float> gradients,
                                Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const std::size_t rays = batch.n, count = rays * samples;
  workspace->begin(backend);
  const Chance chance(seed, kStreamLidarSamples, step, batch);
  Pass pass = propose(backend, batch, &chance, workspace);
  pass.live = pass.all;  // none is empty: each has met something
  pass.field.intervals = pass.intervals;
  sample(backend, &pass, workspace);
  const auto density = pass.raw.subspan(3 * count), weights = workspace->take(count),
             d_weights = workspace->take(count), d_raw = workspace->take(4 * count);
  stages.weights(batch.n, pass.intervals, density, weights);
  const float spread_m = std::max(
      last_range_spread_m,
      first_range_spread_m * std::exp2(-static_cast<float>(step) / range_spread_half_life));
  stages.range_loss(batch.n, pass.intervals, weights, workspace->put(batch.range_m), spread_m,
                    range_weight, d_weights, &workspace->sums().terms[kLidarLoss]);
  backend.fill(d_raw.first(3 * count), 0);  // nobody asks for the colour
  stages.weights_backward(batch.n, pass.intervals, density, weights, d_weights,
                          d_raw.subspan(3 * count));
  backward_field(backend, pass, d_raw, gradients, {}, workspace);
  backward_proposals(backend, pass, weights, gradients, workspace->take<double>(2), workspace);
}

void GridModel::backward_field(kernels::Backend& backend, const Pass& pass,
                               std::span<const float> d_raw, std::span<float> gradients,
                               std::span<float> d_position, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const auto d_features = workspace->take(pass.features.size());
  stages.network_backward(network(), pass.live.rays.n, samples, pass.features, pass.harmonics,
                          d_raw, part_of(gradients, kNetwork), d_features);
  stages.encode_backward(grid(kFieldGrid), pass.field.points, d_features,
                         part_of(gradients, kFieldGrid), d_position);
}

void GridModel::backward_rays(kernels::Backend& backend, const Pass& pass,
                              std::span<const float> d_position, std::span<float> d_origin,
                              std::span<float> d_direction, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const auto d_live_origin = pass.room_of_live(d_origin, 3, workspace),
             d_live_direction = pass.room_of_live(d_direction, 3, workspace);
  stages.contract_backward(contraction, pass.live.rays, pass.field.intervals, d_position,
                           d_live_origin, d_live_direction);
  pass.to_all(stages, kernels::RayLayout::kColumns, d_live_origin, {}, d_origin);
  pass.to_all(stages, kernels::RayLayout::kColumns, d_live_direction, {}, d_direction);
}

/// The proposals learn from the first part of the rays, which stand for all as long as a quarter
/// and more of a batch is drawn evenly: they are fewer numbers than the field and need not see each
/// ray.
void GridModel::backward_proposals(kernels::Backend& backend, const Pass& pass,
                                   std::span<const float> weights, std::span<float> gradients,
                                   std::span<double> losses, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const int taught = std::max(1, pass.all.rays.n / rays_per_proposal_ray);
  const auto of_taught = [&](const kernels::Intervals& all) {
    return kernels::Intervals{
        all.per_ray, all.edges.first(static_cast<std::size_t>(taught) * (all.per_ray + 1))};
  };
  for (std::size_t i = 0; i < losses.size(); ++i) {
    const Round& round = pass.proposal[i];
    const std::size_t count = static_cast<std::size_t>(taught) * round.intervals.per_ray;
    const kernels::Intervals intervals = of_taught(round.intervals);
    const auto density = round.density.first(count), found = round.weights.first(count),
               d_found = workspace->take(count), d_density = workspace->take(count);
    stages.proposal_loss(taught, of_taught(pass.intervals),
                         weights.first(static_cast<std::size_t>(taught) * samples), intervals,
                         found, d_found, &losses[i]);
    stages.weights_backward(taught, intervals, density, found, d_found, d_density);
    stages.proposal_density_backward(grid(kProposalGrid), round.points.first(count), density,
                                     d_density, part_of(gradients, kProposalGrid));
  }
}

}  // namespace redrive
