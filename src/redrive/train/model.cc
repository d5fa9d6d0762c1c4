// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/model.h"

#include "redrive/base/error.h"
#include "redrive/base/rng.h"

namespace redrive {

std::span<const float> NerfModel::network(int index) const {
  const std::size_t count = nerf_parameter_count(config);
  REDRIVE_CHECK_OP(index, <, networks());
  REDRIVE_CHECK_OP(parameters.size(), ==, count * networks());
  return parameters.span().subspan(count * index, count);
}

TrainState initial_state(const NerfConfig& config, int samples, int fine_samples, const Scene& scene,
                         std::uint64_t seed) {
  TrainState state;
  state.model.config = config;
  state.model.samples = samples;
  state.model.fine_samples = fine_samples;
  state.model.near_m = static_cast<float>(scene.near_m);
  state.model.far_m = static_cast<float>(scene.far_m);
  state.model.unit_from_world = scene.unit_from_world;
  const std::size_t count = nerf_parameter_count(config);
  const std::size_t total = count * state.model.networks();
  state.model.parameters = Buffer<float>(total);
  state.first_moment = Buffer<float>(total);
  state.second_moment = Buffer<float>(total);
  state.seed = seed;
  for (int network = 0; network < state.model.networks(); ++network)
    nerf_initialize(config, random_key(seed, kStreamInit, network),
                    state.model.parameters.span().subspan(count * network, count));
  return state;
}

}  // namespace redrive
