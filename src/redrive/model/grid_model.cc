// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/grid_model.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <Eigen/Core>

#include "redrive/field/sky.h"
#include "redrive/loss/photometric.h"
#include "redrive/volume/median_distance.h"

namespace redrive {

namespace {

constexpr int kRaysPerTaughtRay = 4;

// A surface may first be found anywhere near a return, in the end within what the range and the
// time of a point leave uncertain.
constexpr float kFirstSpread_m = 1, kLastSpread_m = 0.1f, kSpreadHalvesIn = 300;  // m, m, steps

/// A ray on which the proposals see less than this is taken for empty: at most two and a half steps of 255.
constexpr float kEmptyOpacity = 0.01f;
/// Of those in training, so that what grows there is seen.
constexpr float kEmptyRaysKept = 1 / 16.0f;

// What the host does between the stages, it does on its own copy of the workspace: fetch before reading, put after writing.

/// The rows of `live` rays, `width` numbers each.
std::span<float> pick_rows(kernels::Backend& backend, std::span<const float> from, int width, std::span<const int> live,
                           Workspace* workspace) {
  const std::span<float> out = workspace->take(live.size() * width);
  backend.fetch(from);
  for (std::size_t i = 0; i < live.size(); ++i)
    std::copy_n(&from[static_cast<std::size_t>(live[i]) * width], width, &out[i * width]);
  backend.put(out);
  return out;
}

/// The same of [rows, rays] that the host has.
std::span<float> pick_columns(kernels::Backend& backend, std::span<const float> from, int rows,
                              std::span<const int> live, Workspace* workspace) {
  const std::span<float> out = workspace->take(live.size() * rows);
  const std::size_t rays = from.size() / rows;
  for (int row = 0; row < rows; ++row)
    for (std::size_t i = 0; i < live.size(); ++i) out[row * live.size() + i] = from[row * rays + live[i]];
  backend.put(out);
  return out;
}

/// Where they are and look to.
RayBatch pick_rays(const RayBatch& batch, std::span<const int> live) {
  RayBatch out;
  out.n = static_cast<int>(live.size());
  for (const int ray : live) out.pixel_angle.push_back(batch.pixel_angle[ray]);
  for (int k = 0; k < 3; ++k)
    for (const int ray : live) {
      out.origin.push_back(batch.origin[k * batch.n + ray]);
      out.direction.push_back(batch.direction[k * batch.n + ray]);
    }
  return out;
}

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

/// Each group's row for each of its rays.
std::span<float> rows_of_groups(kernels::Backend& backend, std::span<const float> from, int width,
                                std::span<const std::uint32_t> group, Workspace* workspace) {
  const std::span<float> out = workspace->take(std::size_t{group.back()} * width);
  backend.fetch(from);
  for (std::size_t g = 0; g + 1 < group.size(); ++g)
    for (std::size_t ray = group[g]; ray < group[g + 1]; ++ray) std::copy_n(&from[g * width], width, &out[ray * width]);
  backend.put(out);
  return out;
}

}  // namespace

/// Of a step: of the three rounds of sampling, and of which empty rays are looked at all the same.
struct GridModel::Chance {
  std::array<std::uint64_t, 3> of_round;
  std::uint64_t of_empty;

  Chance(std::uint64_t seed, std::uint64_t stream, std::int64_t step) {
    const auto first = 4 * static_cast<std::uint64_t>(step);
    for (int round = 0; round < 3; ++round) of_round[round] = random_key(seed, stream, first + round);
    of_empty = random_key(seed, stream, first + 3);
  }
};

/// Intervals of one round with their points.
struct GridModel::Round {
  kernels::Intervals intervals;
  kernels::UnitPoints points;
  std::span<float> density, weights;
};

/// Of all rays, but for what the field is asked for: of the live ones, those that are not empty.
struct GridModel::Pass {
  Round proposal[2];
  kernels::Intervals intervals;  ///< the field's
  std::span<float> background, sky_features, gains;
  kernels::UnitPoints sky_points;

  std::vector<int> live;  ///< ascending
  Round field;
  kernels::Samples samples;
  std::span<float> features, harmonics, raw, background_of_live;

  bool some_are_empty() const { return live.size() * (intervals.per_ray + 1) < intervals.edges.size(); }
};

GridModel::Round GridModel::place(kernels::Backend& backend, const RayBatch& batch, int per_ray,
                                  std::span<const float> edges, Workspace* workspace) const {
  const std::size_t count = static_cast<std::size_t>(batch.n) * per_ray;
  const auto position = workspace->take(3 * count), footprint = workspace->take(count);
  Round round;
  round.intervals = {per_ray, edges};
  backend.grid().contract(contraction, rays_of(batch), std::span(batch.pixel_angle).first(batch.n), round.intervals,
                          position, footprint);
  round.points = {count, position, footprint};
  return round;
}

void GridModel::look_at_sky(kernels::Backend& backend, const RayBatch& batch, Pass* pass, Workspace* workspace) const {
  const std::size_t rays = batch.n;
  const auto position = workspace->take(3 * rays), footprint = workspace->take(rays);
  pass->harmonics = workspace->take(rays * kHarmonics);
  for (std::size_t ray = 0; ray < rays; ++ray) {
    float d[3];
    for (int k = 0; k < 3; ++k) {
      d[k] = batch.direction[k * rays + ray];
      position[k * rays + ray] = sky_coordinate(d[k]);
    }
    spherical_harmonics(d, &pass->harmonics[ray * kHarmonics]);
    footprint[ray] = sky_footprint(batch.pixel_angle[ray]);
  }
  for (const std::span<float> written : {position, footprint, pass->harmonics}) backend.put(written);
  pass->background = workspace->take(3 * rays);
  if (sky.levels == 0) {
    if (batch.background.empty())
      std::ranges::fill(pass->background, background);
    else
      std::ranges::copy(batch.background, pass->background.begin());
    backend.put(pass->background);
    return;
  }
  pass->sky_points = {rays, position, footprint};
  pass->sky_features = workspace->take(rays * sky.outputs());
  backend.grid().encode(grid(kSkyGrid), pass->sky_points, pass->sky_features);
  backend.fetch(pass->sky_features);
  for (std::size_t ray = 0; ray < rays; ++ray)
    for (int k = 0; k < 3; ++k)
      pass->background[k * rays + ray] =
          sky_colour(&pass->sky_features[ray * sky.features + k], sky.levels, rays * sky.features);
  backend.put(pass->background);
}

GridModel::Pass GridModel::propose(kernels::Backend& backend, const RayBatch& batch, const Chance* chance,
                                   Workspace* workspace) const {
  kernels::keep(backend, parameters);
  kernels::GridStages& stages = backend.grid();
  const bool jitter = chance != nullptr;
  const auto key = [&](int round) { return chance ? chance->of_round[round] : 0; };
  const auto edges_for = [&](int n, int per_ray) {
    return workspace->take(static_cast<std::size_t>(n) * (per_ray + 1));
  };
  const auto draw = [&](int n, const Round& from, int per_ray, int round) {
    const auto edges = edges_for(n, per_ray);
    stages.proposed(n, from.intervals, from.weights, {per_ray, proposal_padding, jitter, key(round)}, edges);
    return edges;
  };
  const auto look = [&](const RayBatch& rays, int per_ray, std::span<const float> edges) {
    Round round = place(backend, rays, per_ray, edges, workspace);
    round.density = workspace->take(round.points.n);
    round.weights = workspace->take(round.points.n);
    stages.proposal_density(grid(kProposalGrid), density_scale(), round.points, round.density);
    stages.weights(rays.n, round.intervals, round.density, round.weights);
    return round;
  };
  const bool grouped = !batch.group.empty();
  const RayBatch middles = grouped ? middles_of_groups(batch) : RayBatch();
  const RayBatch& first = grouped ? middles : batch;
  const auto [coarse, fine] = proposal_samples;
  Pass pass;
  const auto spaced = edges_for(first.n, coarse);
  stages.spaced(rays_of(first), {coarse, spacing, contraction, jitter, key(0)}, spaced);
  pass.proposal[0] = look(first, coarse, spaced);
  auto edges = draw(first.n, pass.proposal[0], fine, 1);
  if (grouped) edges = rows_of_groups(backend, edges, fine + 1, batch.group, workspace);
  pass.proposal[1] = look(batch, fine, edges);
  pass.intervals = {samples, draw(batch.n, pass.proposal[1], samples, 2)};
  return pass;
}

std::vector<int> GridModel::live_rays(kernels::Backend& backend, const Pass& pass, int n, const Chance* chance) const {
  const Round& round = pass.proposal[1];
  backend.fetch(round.weights);
  std::vector<int> live;
  live.reserve(n);
  for (int ray = 0; ray < n; ++ray) {
    const auto found = round.weights.subspan(static_cast<std::size_t>(ray) * round.intervals.per_ray,
                                             static_cast<std::size_t>(round.intervals.per_ray));
    // Not "below": what is not a number goes on into the loss.
    if (!(std::accumulate(found.begin(), found.end(), 0.0f) < kEmptyOpacity) ||
        (chance && random_unit(chance->of_empty, static_cast<std::uint64_t>(ray)) < kEmptyRaysKept))
      live.push_back(ray);
  }
  if (live.empty()) live.push_back(0);  // stages are for at least one
  return live;
}

void GridModel::sample(kernels::Backend& backend, const RayBatch& batch, Pass* pass, Workspace* workspace) const {
  const std::size_t rays = pass->live.size(), count = rays * samples;
  auto edges = pass->intervals.edges;
  if (pass->some_are_empty()) edges = pick_rows(backend, edges, samples + 1, pass->live, workspace);
  pass->field = place(backend, batch, samples, edges, workspace);
  const auto t = workspace->take(count), dt = workspace->take(count);
  backend.fetch(edges);
  for (std::size_t ray = 0, i = 0; ray < rays; ++ray)
    for (int s = 0; s < samples; ++s, ++i) {
      const float begin = edges[i + ray], end = edges[i + ray + 1];
      t[i] = 0.5f * (begin + end);
      dt[i] = end - begin;
    }
  backend.put(t);
  backend.put(dt);
  pass->samples = {samples, t, dt};
  pass->features = workspace->take(count * field.grid.outputs());
  backend.grid().encode(grid(kFieldGrid), pass->field.points, pass->features);
  pass->raw = workspace->take(4 * count);
}

GridModel::Pass GridModel::forward(kernels::Backend& backend, const RayBatch& batch, const Chance* chance,
                                   const kernels::CompositeOut& out, Workspace* workspace) const {
  const int n = batch.n;
  Pass pass = propose(backend, batch, chance, workspace);
  pass.live = live_rays(backend, pass, n, chance);
  const int live = static_cast<int>(pass.live.size());
  look_at_sky(backend, batch, &pass, workspace);
  pass.background_of_live = pass.background;
  kernels::CompositeOut seen = out;
  if (pass.some_are_empty()) {
    sample(backend, pick_rays(batch, pass.live), &pass, workspace);
    pass.harmonics = pick_rows(backend, pass.harmonics, kHarmonics, pass.live, workspace);
    pass.background_of_live = pick_columns(backend, pass.background, 3, pass.live, workspace);
    seen = {workspace->take(3 * pass.live.size()), workspace->take(live), workspace->take(live),
            workspace->take(static_cast<std::size_t>(live) * samples)};
  } else {
    sample(backend, batch, &pass, workspace);
  }
  backend.grid().network_forward(network(), live, samples, pass.features, pass.harmonics, pass.raw);
  backend.composite_forward(live, pass.samples, pass.raw, pass.background_of_live, seen);
  if (pass.some_are_empty()) {
    for (const std::span<float> read : {seen.rgb, seen.depth, seen.opacity, seen.weights}) backend.fetch(read);
    std::ranges::copy(pass.background, out.rgb.begin());
    for (const std::span<float> rest : {out.depth, out.opacity, out.weights}) std::ranges::fill(rest, 0.0f);
    for (int i = 0; i < live; ++i) {
      const std::size_t ray = pass.live[i];
      for (int k = 0; k < 3; ++k) out.rgb[k * n + ray] = seen.rgb[k * live + i];
      out.depth[ray] = seen.depth[i];
      out.opacity[ray] = seen.opacity[i];
      std::ranges::copy(seen.weights.subspan(static_cast<std::size_t>(i) * samples, samples),
                        out.weights.begin() + static_cast<std::ptrdiff_t>(ray * samples));
    }
    for (const std::span<float> written : {out.rgb, out.depth, out.opacity, out.weights}) backend.put(written);
  }
  pass.gains = workspace->take(out.rgb.size());
  expose(backend, batch, out.rgb, pass.gains);
  return pass;
}

void GridModel::render(kernels::Backend& backend, const RayBatch& batch, const kernels::CompositeOut& out,
                       Workspace* workspace) const {
  workspace->begin(backend);
  const auto weights = workspace->take(static_cast<std::size_t>(batch.n) * samples);
  const Pass pass = forward(backend, batch, nullptr, {out.rgb, out.depth, out.opacity, weights}, workspace);
  backend.fetch(weights);  // the edges sample() has fetched
  for (int ray = 0; ray < batch.n; ++ray)
    out.depth[ray] = median_distance(&pass.intervals.edges[static_cast<std::size_t>(ray) * (samples + 1)],
                                     &weights[static_cast<std::size_t>(ray) * samples], samples, out.opacity[ray]);
}

StepLosses GridModel::gradients(kernels::Backend& backend, const RayBatch& batch, std::uint64_t seed, std::int64_t step,
                                std::span<float> gradients, Workspace* workspace) const {
  const std::size_t rays = batch.n;
  workspace->begin(backend);
  const auto rgb = workspace->take(3 * rays), depth = workspace->take(rays), opacity = workspace->take(rays),
             weights = workspace->take(rays * samples), d_rgb = workspace->take(3 * rays);
  const kernels::CompositeOut out{rgb, depth, opacity, weights};
  const Chance chance(seed, kStreamSamples, step);
  const Pass pass = forward(backend, batch, &chance, out, workspace);

  StepLosses losses;
  losses.field_rays = static_cast<int>(pass.live.size());
  losses.rgb_mse = backend.photometric_loss(rgb, std::span(batch.target).first(3 * rays), d_rgb);
  backend.fetch(d_rgb);
  losses.colours = robust(batch, rgb, d_rgb, &losses.squares);
  if (batch.by_error > 0)
    losses.rgb_mse = std::accumulate(losses.squares.begin(), losses.squares.end() - batch.by_error, 0.0) /
                     (batch.n - batch.by_error);
  losses.colours += unexpose(backend, batch, rgb, pass.gains, d_rgb, gradients);
  backend.put(d_rgb);
  backend.fetch(opacity);
  for (const float value : opacity) losses.opacity += value / static_cast<double>(rays);

  const auto d_raw = workspace->take(pass.raw.size());
  const auto d_seen = pass.some_are_empty() ? pick_columns(backend, d_rgb, 3, pass.live, workspace) : d_rgb;
  backend.composite_backward(losses.field_rays, pass.samples, pass.raw, pass.background_of_live, {d_seen, {}}, d_raw);
  const bool moves = batch.refines;
  const auto d_field = moves ? workspace->take(3 * pass.field.points.n) : std::span<float>(),
             d_sky = moves && sky.levels > 0 ? workspace->take(3 * rays) : std::span<float>();
  backward_field(backend, pass, d_raw, gradients, d_field, workspace);
  backward_sky(backend, batch.n, pass, opacity, d_rgb, gradients, d_sky, workspace);
  if (moves) backward_rays(backend, batch, pass, d_field, d_sky, &losses, workspace);
  losses.loss = losses.colours + backward_proposals(backend, batch.n, pass, weights, gradients, workspace);
  return losses;
}

double GridModel::range_gradients(kernels::Backend& backend, const RayBatch& batch, std::uint64_t seed,
                                  std::int64_t step, std::span<float> gradients, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const std::size_t rays = batch.n, count = rays * samples;
  workspace->begin(backend);
  const Chance chance(seed, kStreamLidarSamples, step);
  Pass pass = propose(backend, batch, &chance, workspace);
  pass.live.resize(rays);  // none is empty: each has met something
  std::iota(pass.live.begin(), pass.live.end(), 0);
  sample(backend, batch, &pass, workspace);
  pass.harmonics = workspace->take(rays * kHarmonics);
  std::ranges::fill(pass.harmonics, 0.0f);  // nobody asks for the colour
  backend.put(pass.harmonics);
  stages.network_forward(network(), batch.n, samples, pass.features, pass.harmonics, pass.raw);
  const auto density = pass.raw.subspan(3 * count), weights = workspace->take(count),
             d_weights = workspace->take(count), d_raw = workspace->take(4 * count);
  stages.weights(batch.n, pass.intervals, density, weights);
  const float spread_m =
      std::max(kLastSpread_m, kFirstSpread_m * std::exp2(-static_cast<float>(step) / kSpreadHalvesIn));
  const double loss = stages.range(batch.n, pass.intervals, weights, batch.range_m, spread_m, kRangeWeight, d_weights);
  std::ranges::fill(d_raw.first(3 * count), 0.0f);
  backend.put(d_raw.first(3 * count));
  stages.weights_backward(batch.n, pass.intervals, density, weights, d_weights, d_raw.subspan(3 * count));
  backward_field(backend, pass, d_raw, gradients, {}, workspace);
  backward_proposals(backend, batch.n, pass, weights, gradients, workspace);
  return loss;
}

void GridModel::backward_field(kernels::Backend& backend, const Pass& pass, std::span<const float> d_raw,
                               std::span<float> gradients, std::span<float> d_position, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const auto d_features = workspace->take(pass.features.size());
  stages.network_backward(network(), static_cast<int>(pass.live.size()), samples, pass.features, pass.harmonics, d_raw,
                          part_of(gradients, kNetwork), d_features);
  stages.encode_backward(grid(kFieldGrid), pass.field.points, d_features, part_of(gradients, kFieldGrid), d_position);
}

void GridModel::backward_sky(kernels::Backend& backend, int n, const Pass& pass, std::span<const float> opacity,
                             std::span<const float> d_rgb, std::span<float> gradients, std::span<float> d_position,
                             Workspace* workspace) const {
  const std::size_t rays = n;
  if (sky.levels == 0) return;
  const auto d_sky = workspace->take(pass.sky_features.size());
  std::ranges::fill(d_sky, 0.0f);
  for (std::size_t ray = 0; ray < rays; ++ray)
    for (int k = 0; k < 3; ++k) {
      const std::size_t at = k * rays + ray;
      const float d = sky_colour_adjoint(pass.background[at], (1 - opacity[ray]) * d_rgb[at]);
      for (int l = 0; l < sky.levels; ++l) d_sky[(l * rays + ray) * sky.features + k] = d;
    }
  backend.put(d_sky);
  backend.grid().encode_backward(grid(kSkyGrid), pass.sky_points, d_sky, part_of(gradients, kSkyGrid), d_position);
}

void GridModel::backward_rays(kernels::Backend& backend, const RayBatch& batch, const Pass& pass,
                              std::span<const float> d_field, std::span<const float> d_sky, StepLosses* losses,
                              Workspace* workspace) const {
  const std::size_t rays = batch.n, live = pass.live.size();
  losses->d_origin.assign(3 * rays, 0.0f);
  losses->d_direction.assign(3 * rays, 0.0f);
  const auto d_origin = workspace->take(3 * live), d_direction = workspace->take(3 * live);
  const RayBatch picked = pass.some_are_empty() ? pick_rays(batch, pass.live) : RayBatch();
  backend.grid().contract_backward(contraction, rays_of(pass.some_are_empty() ? picked : batch), pass.field.intervals,
                                   d_field, d_origin, d_direction);
  for (const std::span<const float> read :
       {std::span<const float>(d_origin), std::span<const float>(d_direction), d_sky})
    backend.fetch(read);
  for (int k = 0; k < 3; ++k) {
    for (std::size_t i = 0; i < live; ++i) {
      losses->d_origin[k * rays + pass.live[i]] = d_origin[k * live + i];
      losses->d_direction[k * rays + pass.live[i]] = d_direction[k * live + i];
    }
    if (!d_sky.empty())  // as look_at_sky places it
      for (std::size_t at = k * rays; at < (k + 1) * rays; ++at)
        losses->d_direction[at] += sky_coordinate_adjoint(d_sky[at]);
  }
}

double GridModel::robust(const RayBatch& batch, std::span<const float> rgb, std::span<float> d_rgb,
                         std::vector<float>* squares) const {
  const std::size_t rays = batch.n;
  squares->resize(rays);
  double loss = 0;
  for (std::size_t ray = 0; ray < rays; ++ray) {
    float square = 0;
    for (std::size_t at = ray; at < 3 * rays; at += rays)
      square += (rgb[at] - batch.target[at]) * (rgb[at] - batch.target[at]);
    (*squares)[ray] = square / 3;
    const auto huber = huber_term(square, huber_edge);
    const float weight = batch.weight.empty() ? 1 : batch.weight[ray];
    loss += weight * huber.value;
    for (std::size_t at = ray; at < 3 * rays; at += rays) d_rgb[at] *= weight * huber.factor;
  }
  return loss / (3.0 * static_cast<double>(rays));
}

void GridModel::expose(kernels::Backend& backend, const RayBatch& batch, std::span<float> rgb,
                       std::span<float> gains) const {
  const std::size_t rays = batch.n;
  const std::span<const float> parameters = part(kAppearance);  // not ray by ray: finding a part costs a microsecond
  backend.fetch(parameters);
  backend.fetch(rgb);
  for (std::size_t ray = 0; ray < rays; ++ray) {
    const auto of_ray =
        colour_gains(appearance, parameters.data(), batch.exposure.empty() ? Exposure{} : batch.exposure[ray]);
    for (int k = 0; k < 3; ++k) {
      gains[k * rays + ray] = of_ray[k];
      rgb[k * rays + ray] *= of_ray[k];
    }
  }
  backend.put(rgb);
}

double GridModel::unexpose(kernels::Backend& backend, const RayBatch& batch, std::span<const float> rgb,
                           std::span<const float> gains, std::span<float> d_rgb, std::span<float> gradients) const {
  if (appearance.size() == 0 || batch.exposure.empty()) return 0;
  const std::size_t rays = batch.n;
  const std::span<const float> parameters = part(kAppearance);
  const std::span<float> d_parameters = part_of(gradients, kAppearance);
  backend.fetch(d_parameters);
  for (std::size_t ray = 0; ray < rays; ++ray) {
    std::array<float, 3> of_ray, d_gains;
    for (int k = 0; k < 3; ++k) {
      const std::size_t at = k * rays + ray;
      of_ray[k] = gains[at];
      d_gains[k] = d_rgb[at] * rgb[at] / gains[at];
      d_rgb[at] *= gains[at];
    }
    colour_gains_adjoint(appearance, batch.exposure[ray], of_ray, d_gains,
                         [&](std::size_t at, float derivative) { d_parameters[at] += derivative; });
  }
  double loss = 0;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const GainTerm<float> term = gain_term(appearance, parameters[i]);
    loss += term.value;
    d_parameters[i] += term.derivative;
  }
  backend.put(d_parameters);
  return loss;
}

/// The proposals learn from the first part of the rays, which stand for all as long as a quarter and more of a batch is drawn evenly: they
/// are fewer numbers than the field and need not see each ray.
double GridModel::backward_proposals(kernels::Backend& backend, int n, const Pass& pass, std::span<const float> weights,
                                     std::span<float> gradients, Workspace* workspace) const {
  kernels::GridStages& stages = backend.grid();
  const int taught = std::max(1, n / kRaysPerTaughtRay);
  const auto of_taught = [&](const kernels::Intervals& all) {
    return kernels::Intervals{all.per_ray, all.edges.first(static_cast<std::size_t>(taught) * (all.per_ray + 1))};
  };
  double loss = 0;
  for (const Round& round : pass.proposal) {
    const std::size_t count = static_cast<std::size_t>(taught) * round.intervals.per_ray;
    const kernels::Intervals intervals = of_taught(round.intervals);
    const auto density = round.density.first(count), found = round.weights.first(count),
               d_found = workspace->take(count), d_density = workspace->take(count);
    loss += stages.proposal(taught, of_taught(pass.intervals),
                            weights.first(static_cast<std::size_t>(taught) * samples), intervals, found, d_found);
    stages.weights_backward(taught, intervals, density, found, d_found, d_density);
    stages.proposal_density_backward(grid(kProposalGrid), round.points.first(count), density, d_density,
                                     part_of(gradients, kProposalGrid));
  }
  return loss;
}

}  // namespace redrive
