// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/trainee.h"

namespace redrive {

AdamState Trainee::zero_moments() const {
  const std::size_t packed = updated_in_step(), others = size() - packed;
  return {Buffer<float>(others), Buffer<float>(others), Buffer<std::uint32_t>(packed),
          Buffer<float>(errors())};
}

void Trainee::update(kernels::Backend& backend, double learning_rate, std::int64_t step,
                     std::span<float> gradients, AdamState* adam) {
  for (const AdamGroup& group : adam_groups(learning_rate, step)) {
    const auto part = [&](std::span<float> all) { return all.subspan(group.offset, group.size); };
    backend.adam(group.step, part(gradients), part(parameters), part(adam->first_moment),
                 part(adam->second_moment));
  }
}

}  // namespace redrive
