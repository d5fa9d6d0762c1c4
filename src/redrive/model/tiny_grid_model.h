// SPDX-License-Identifier: Apache-2.0
// A grid model for tests, small enough for plain loops.
#pragma once

#include <cstdint>

#include "redrive/base/rng.h"
#include "redrive/model/grid_model.h"

namespace redrive {

/// -1..1.
inline double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(61, kStreamTest, stream), i) - 1;
}

/// Dense and hashed levels, a near region that the rays leave, and parameters of order 1.
inline void make_tiny(GridModel& model, int colour_layers = 1) {
  model.field = {{2, 8, 3, 9, 8}, 16, colour_layers};
  model.proposal = {2, 1, 3, 8, 7};
  model.sky = {2, 4, 2, 6, 6};
  model.contraction = {{0.5f, 0, -0.25f}, 3, true};
  model.spacing = {0.5f, 20, 4};
  model.proposal_samples = {8, 6};
  model.samples = 5;
  model.appearance = {2, 3};
  model.initialize(4);
  // The networks' weights stay as they begin; tables would be far too small to matter.
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.shape.size() != 2)
      for (std::int64_t i = 0; i < tensor.shape[0]; ++i)
        model.parameters[tensor.offset + i] = static_cast<float>(uniform(1, tensor.offset + i));
}

}  // namespace redrive
