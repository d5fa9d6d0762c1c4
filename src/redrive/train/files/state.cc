// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/state.h"

namespace redrive {

TrainState initial_state(std::unique_ptr<Trainee> model, std::uint64_t seed) {
  TrainState state;
  state.model = std::move(model);
  state.model->initialize(seed);
  state.adam = state.model->zero_moments();
  state.seed = seed;
  return state;
}

}  // namespace redrive
