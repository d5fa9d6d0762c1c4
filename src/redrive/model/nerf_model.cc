// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/nerf_model.h"

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {

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

void NerfModel::visit_numbers(NumberVisitor& visit) {
  visit("width", config.width);
  visit("position_octaves", config.position_octaves);
  visit("direction_octaves", config.direction_octaves);
  visit("samples", samples);
  visit("fine_samples", fine_samples);
  visit("near_m", near_m);
  visit("far_m", far_m);
  visit("unit_from_world.center_x", unit_from_world.center[0]);
  visit("unit_from_world.center_y", unit_from_world.center[1]);
  visit("unit_from_world.center_z", unit_from_world.center[2]);
  visit("unit_from_world.scale", unit_from_world.scale);
}

void NerfModel::check(const std::filesystem::path& file) const {
  const auto require = [&](bool holds, const char* field, auto value, const char* rule) {
    if (!holds)
      throw InputError(file, std::string("__metadata__.") + field, std::to_string(value), rule);
  };
  require(config.width >= 32 && config.width <= 512 && config.width % 32 == 0, "width",
          config.width, "must be a multiple of 32 in 32..512");
  require(config.position_octaves >= 1 && config.position_octaves <= 10, "position_octaves",
          config.position_octaves, "must be in 1..10");
  require(config.direction_octaves >= 1 && config.direction_octaves <= 4, "direction_octaves",
          config.direction_octaves, "must be in 1..4");
  require(samples >= 3 && samples <= 1024, "samples", samples, "must be in 3..1024");
  require(fine_samples >= 0 && fine_samples <= 1024, "fine_samples", fine_samples,
          "must be in 0..1024");
  require(near_m > 0, "near_m", near_m, "must be above 0");
  require(far_m > near_m, "far_m", far_m, "must be above near_m");
  require(unit_from_world.scale > 0, "unit_from_world.scale", unit_from_world.scale,
          "must be above 0");
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

StepOutput NerfModel::gradients(kernels::Backend& backend, const RayBatch& batch,
                                std::uint64_t seed, std::int64_t step, std::span<float> gradients,
                                Workspace* workspace) const {
  kernels::make_resident(backend, parameters);
  const std::size_t n = batch.n, coarse = n * samples, fine = n * (samples + fine_samples);
  workspace->begin(backend);
  const kernels::Rays rays = upload_rays(batch, workspace);
  const auto target = workspace->put(std::span(batch.target).first(3 * n));
  const auto opacity = workspace->take(n), depth = workspace->take(n);

  // Section 4: stratified samples, the field at each, the colour of the ray (eq. 3), its squared
  // error, and back.
  const auto t = workspace->take(coarse), dt = workspace->take(coarse),
             weights = workspace->take(fine_samples > 0 ? coarse : 0);
  // Random numbers of this step: `each` a ray.
  const auto key = [&](std::uint64_t stream, int each) {
    return advance_key(random_key(seed, stream, step), batch.first_ray * each);
  };
  backend.nerf().sample_stratified(
      batch.n, {samples, near_m, far_m, true, key(kStreamSamples, samples)}, t, dt);
  const kernels::Samples coarse_samples{samples, t, dt};
  StepOutput losses;
  const std::size_t refined = batch.refines ? 3 * n : 0;
  const kernels::RayGradients of_rays{workspace->take(refined),
                                      workspace->take(refined)};  // both networks add to them
  backend.fill(of_rays.d_origin, 0);
  backend.fill(of_rays.d_direction, 0);
  LossTerms& sums = workspace->sums();
  backend.nerf().train_rays(field(0), rays, coarse_samples, target,
                            {workspace->take(3 * n), depth, opacity, weights},
                            gradients.first(nerf_parameter_count(config)), of_rays,
                            fine_samples > 0 ? &sums.coarse : &sums.rgb_mse);

  // Section 5.2: further samples where the coarse network found matter, seen by the fine network.
  if (fine_samples > 0) {
    const auto fine_t = workspace->take(fine), fine_dt = workspace->take(fine);
    backend.nerf().sample_hierarchical(coarse_samples, weights, fine_samples, true,
                                       key(kStreamFineSamples, fine_samples), fine_t, fine_dt);
    backend.nerf().train_rays(field(1), rays, {samples + fine_samples, fine_t, fine_dt}, target,
                              {workspace->take(3 * n), depth, opacity, {}},
                              gradients.last(nerf_parameter_count(config)), of_rays, &sums.rgb_mse);
  }
  backend.mean(opacity, &sums.opacity);
  losses.d_origin.resize(refined);
  losses.d_direction.resize(refined);
  workspace->get(of_rays.d_origin, losses.d_origin);
  workspace->get(of_rays.d_direction, losses.d_direction);
  return losses;
}

/// Coarse samples in the middle of their bins; where the model has a fine network, its samples are
/// the coarse ones and those drawn from the coarse weights (NeRF section 5.2), and only the fine
/// colours count.
void NerfModel::render(kernels::Backend& backend, const RayBatch& batch,
                       const kernels::CompositeOut& out, Workspace* workspace) const {
  kernels::make_resident(backend, parameters);
  const std::size_t n = batch.n, coarse_size = n * samples,
                    fine_size = n * (samples + fine_samples);
  workspace->begin(backend);
  const kernels::Rays rays = upload_rays(batch, workspace);
  const auto rgb = workspace->take(3 * n), depth = workspace->take(n), opacity = workspace->take(n),
             t = workspace->take(coarse_size), dt = workspace->take(coarse_size),
             weights = workspace->take(fine_samples > 0 ? coarse_size : 0);
  backend.nerf().sample_stratified(batch.n, {samples, near_m, far_m, /*jitter=*/false, /*key=*/0},
                                   t, dt);
  const kernels::Samples coarse{samples, t, dt};
  backend.nerf().render_rays(field(0), rays, coarse, {rgb, depth, opacity, weights});
  if (fine_samples > 0) {
    const auto fine_t = workspace->take(fine_size), fine_dt = workspace->take(fine_size);
    backend.nerf().sample_hierarchical(coarse, weights, fine_samples, /*jitter=*/false, /*key=*/0,
                                       fine_t, fine_dt);
    backend.nerf().render_rays(field(1), rays, {samples + fine_samples, fine_t, fine_dt},
                               {rgb, depth, opacity, {}});
  }
  workspace->get(rgb, out.rgb);
  workspace->get(depth, out.depth);
  workspace->get(opacity, out.opacity);
}

}  // namespace redrive
