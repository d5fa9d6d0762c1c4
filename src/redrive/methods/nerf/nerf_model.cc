// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/nerf/nerf_model.h"

#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/base/numbers.h"
#include "redrive/base/rng.h"

namespace redrive {
namespace {

enum LossSlot { kCoarseLoss };  // in StepSums::terms

std::string general(double number) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", number);
  return text;
}

}  // namespace

std::span<const float> NerfModel::network(int index) const {
  const std::size_t count = nerf_parameter_count(config);
  REDRIVE_CHECK_OP(index, <, networks());
  REDRIVE_CHECK_OP(parameters.size(), ==, count * networks());
  return parameters.span().subspan(count * index, count);
}

std::string NerfModel::describe() const {
  return "width " + std::to_string(config.width) + ", " + std::to_string(samples) +
         (fine_samples > 0 ? " + " + std::to_string(fine_samples) : "") + " samples per ray";
}

Method nerf_method() {
  return {.name = "nerf",
          .help = "the original NeRF (Mildenhall et al. 2020)",
          .make = [] { return std::unique_ptr<Trainee>(std::make_unique<NerfModel>()); },
          .defaults = {{"near", "1"}, {"far", "10"}, {"epochs", "4"}, {"max-seconds", "0"}},
          .presets = {{"report-1",
                       "first setup of the report",
                       {{"near", "1"}, {"far", "10"}, {"masks", "none"}},
                       {{"F_MIDLONGRANGECAM_CL"}}},
                      {"report-2",
                       "second setup",
                       {{"near", "1"},
                        {"far", "10"},
                        {"masks", "none"},
                        {"width", "128"},
                        {"samples", "48"},
                        {"epochs", "2"}},
                       {{"F_MIDLONGRANGECAM_CL"}, {"F_MIDRANGECAM_C", "B_MIDRANGECAM_C"}}}},
          .benchmarks = nerf_benchmarks};
}

void NerfModel::visit_hyperparameters(HyperparameterVisitor& visit) {
  visit(Hyperparameter{"width", "hidden units of the network", 32, 512}.multiple_of(32).as_option(
            "width"),
        config.width);
  visit({"position_octaves", "frequencies of the positional encoding of a position", 1, 10},
        config.position_octaves);
  visit({"direction_octaves", "frequencies of the positional encoding of a direction", 1, 4},
        config.direction_octaves);
  visit(Hyperparameter{"samples", "samples of a ray", 3, 1024}.as_option("samples"), samples);
  visit(Hyperparameter{"fine_samples",
                       "further samples by a second network, drawn from the first one's weights", 0,
                       1024}
            .as_option("fine-samples"),
        fine_samples);
  visit_batch(visit);
  visit(Hyperparameter{"learning_rate", "learning rate of Adam at the start", 0, 1}
            .exclusive()
            .as_option("learning-rate"),
        initial_rate);
  visit(Hyperparameter{"lr_gamma", "factor of the learning rate at each milestone", 0, 1}
            .exclusive()
            .as_option("lr-gamma"),
        rate_gamma);
  visit(
      Hyperparameter{
          "lr_milestones",
          "A,B,C: steps at which the learning rate falls; none: 1/2, 3/4 and 7/8 of all steps", 1}
          .as_option("lr-milestones"),
      milestones);
  visit(Hyperparameter{"near_m", "first sample of a ray, m", 0}.exclusive().from_recording(),
        near_m);
  visit(Hyperparameter{"far_m", "last sample of a ray, m", 0}.exclusive().from_recording(), far_m);
  constexpr const char* kCenter = "centre of the network's unit cube in the world, m";
  visit({"unit_from_world.center_x", kCenter}, unit_from_world.center[0]);
  visit({"unit_from_world.center_y", kCenter}, unit_from_world.center[1]);
  visit({"unit_from_world.center_z", kCenter}, unit_from_world.center[2]);
  visit(Hyperparameter{"unit_from_world.scale",
                       "1 / half the side of the unit cube in the world, 1/m", 0}
            .exclusive(),
        unit_from_world.scale);
}

void NerfModel::check(const HyperparameterFailure& fail) const {
  if (!(far_m > near_m)) fail({"far_m", ""}, std::to_string(far_m), "must be above near_m");
  check_batch(samples_per_ray(), fail);
}

void NerfModel::configure(const Scene& scene) {
  near_m = static_cast<float>(scene.near_m);
  far_m = static_cast<float>(scene.far_m);
  unit_from_world = scene.unit_from_world;
}

std::vector<std::int64_t> NerfModel::milestones_of(std::int64_t total_steps) const {
  if (!milestones.empty()) return milestones;
  if (total_steps < 8) return {};  // the fractions would coincide, or be step 0
  return {total_steps / 2, total_steps * 3 / 4, total_steps * 7 / 8};
}

double NerfModel::learning_rate(const Schedule& at) const {
  return multi_step_learning_rate(initial_rate, rate_gamma, milestones_of(at.total_steps), at.step);
}

std::string NerfModel::describe_schedule(std::int64_t total_steps) const {
  std::string text = "learning rate " + general(initial_rate);
  const std::vector<std::int64_t> at = milestones_of(total_steps);
  if (!at.empty()) text += ", times " + general(rate_gamma) + " at";
  for (const std::int64_t milestone : at) {
    text += ' ';
    text += std::to_string(milestone);
  }
  return text;
}

std::vector<LossTerm> NerfModel::loss_terms(const StepSums& sums) const {
  return {{"coarse", sums.terms[kCoarseLoss]}, {"colour", sums.rgb_mse}};
}

std::uint64_t NerfModel::step_bytes() const {
  // Each chunk of kernels/cpu has gradients of a whole network, and sixteen floats per neuron and
  // sample of a tile.
  constexpr std::uint64_t kChunks = 8, kTileSamples = 192, kTileNeuron = 16 * sizeof(float);
  return RayModel::step_bytes() +
         kChunks * (sizeof(float) * size() +
                    kTileSamples * kTileNeuron * static_cast<std::uint64_t>(config.width));
}

std::vector<ModelTensor> NerfModel::tensors() const {
  std::vector<ModelTensor> out;
  for (int network = 0; network < networks(); ++network)
    for (const NerfTensor& tensor : nerf_tensors(config)) {
      std::vector<std::int64_t> shape = {tensor.rows};  // a bias, as Python expects it
      if (tensor.columns != 1) shape.push_back(tensor.columns);
      out.push_back({(network == 0 ? "coarse." : "fine.") + tensor.name, shape,
                     network * nerf_parameter_count(config) + tensor.offset});
    }
  return out;
}

void NerfModel::initialize(std::uint64_t seed) {
  const std::size_t count = nerf_parameter_count(config);
  parameters = Buffer<float>(size());
  for (int network = 0; network < networks(); ++network)
    nerf_initialize(config, random_key(seed, kStreamInit, network),
                    parameters.span().subspan(count * network, count));
}

RayGradientsOutput NerfModel::gradients(kernels::Backend& backend, const RayBatch& batch,
                                        std::uint64_t seed, std::int64_t step,
                                        std::span<float> gradients, Workspace* workspace) const {
  const std::size_t n = batch.n, coarse = n * samples, fine = n * (samples + fine_samples);
  workspace->begin();
  const kernels::Rays rays = rays_of(batch);
  const auto target = std::span(batch.target).first(3 * n);
  const auto opacity = workspace->take(n), depth = workspace->take(n);

  // Section 4: stratified samples, the field at each, the colour of the ray (eq. 3), its squared
  // error, and the backward pass.
  const auto t = workspace->take(coarse), dt = workspace->take(coarse),
             weights = workspace->take(fine_samples > 0 ? coarse : 0);
  // Random numbers of this step: `each` per ray.
  const auto key = [&](std::uint64_t stream, int each) {
    return advance_key(random_key(seed, stream, step), batch.first_ray * each);
  };
  backend.nerf().sample_stratified(
      batch.n, {samples, near_m, far_m, true, key(kStreamSamples, samples)}, t, dt);
  const kernels::Samples coarse_samples{samples, t, dt};
  RayGradientsOutput losses;
  losses.d_origin.resize(batch.refines ? 3 * n : 0);
  losses.d_direction.resize(losses.d_origin.size());
  const kernels::RayGradients of_rays{losses.d_origin, losses.d_direction};  // both networks add
  StepSums& sums = workspace->sums();
  backend.nerf().train_rays(field(0), rays, coarse_samples, target,
                            {workspace->take(3 * n), depth, opacity, weights},
                            gradients.first(nerf_parameter_count(config)), of_rays,
                            fine_samples > 0 ? &sums.terms[kCoarseLoss] : &sums.rgb_mse);

  // Section 5.2: further samples by the coarse network's weights, evaluated by the fine network.
  if (fine_samples > 0) {
    const auto fine_t = workspace->take(fine), fine_dt = workspace->take(fine);
    backend.nerf().sample_hierarchical(coarse_samples, weights, fine_samples, true,
                                       key(kStreamFineSamples, fine_samples), fine_t, fine_dt);
    backend.nerf().train_rays(field(1), rays, {samples + fine_samples, fine_t, fine_dt}, target,
                              {workspace->take(3 * n), depth, opacity, {}},
                              gradients.last(nerf_parameter_count(config)), of_rays, &sums.rgb_mse);
  }
  sums.opacity = mean_of(opacity);
  return losses;
}

/// Renders with coarse samples at the middle of their bins. A fine network is evaluated at these
/// and at samples drawn from the coarse weights (NeRF section 5.2); then only its colours are used.
void NerfModel::render_rays(kernels::Backend& backend, const RayBatch& batch,
                            const kernels::CompositeOut& out, Workspace* workspace) const {
  const std::size_t n = batch.n, coarse_size = n * samples,
                    fine_size = n * (samples + fine_samples);
  workspace->begin();
  const kernels::Rays rays = rays_of(batch);
  const kernels::CompositeOut image{out.rgb, out.depth, out.opacity, {}};
  const auto t = workspace->take(coarse_size), dt = workspace->take(coarse_size),
             weights = workspace->take(fine_samples > 0 ? coarse_size : 0);
  backend.nerf().sample_stratified(batch.n, {samples, near_m, far_m, /*jitter=*/false, /*key=*/0},
                                   t, dt);
  const kernels::Samples coarse{samples, t, dt};
  backend.nerf().render_rays(field(0), rays, coarse, {out.rgb, out.depth, out.opacity, weights});
  if (fine_samples > 0) {
    const auto fine_t = workspace->take(fine_size), fine_dt = workspace->take(fine_size);
    backend.nerf().sample_hierarchical(coarse, weights, fine_samples, /*jitter=*/false, /*key=*/0,
                                       fine_t, fine_dt);
    backend.nerf().render_rays(field(1), rays, {samples + fine_samples, fine_t, fine_dt}, image);
  }
}

}  // namespace redrive
