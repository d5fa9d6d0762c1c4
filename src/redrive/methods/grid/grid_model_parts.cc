// SPDX-License-Identifier: Apache-2.0
// Tensors of the grid model, their sizes and initial values. grid_model.cc computes with them.
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/methods/grid/grid_model.h"

namespace redrive {

std::size_t GridModel::part_size(int part) const {
  switch (part) {
    case kFieldGrid: return hash_grid_size(field.grid);
    case kNetwork: return grid_network_size(field);
    case kProposalGrid: return hash_grid_size(proposal);
    case kSkyGrid: return sky.n_levels > 0 ? hash_grid_size(sky) : 0;
    default: return appearance.size();
  }
}

std::size_t GridModel::offset(int part) const {
  std::size_t sum = 0;
  for (int i = 0; i < part; ++i) sum += part_size(i);
  return sum;
}

kernels::HashGrid GridModel::grid(Part which) const {
  return {which == kFieldGrid ? field.grid : which == kProposalGrid ? proposal : sky, part(which)};
}

std::string GridModel::describe() const {
  return std::to_string(field.grid.n_levels) + " levels x " +
         std::to_string(field.grid.features_per_level) + " of 2^" +
         std::to_string(field.grid.log2_hashmap_size) + " rows, width " +
         std::to_string(field.width) + ", " + std::to_string(proposal_samples[0]) + " + " +
         std::to_string(proposal_samples[1]) + " + " + std::to_string(samples) + " samples per ray";
}

std::vector<ModelTensor> GridModel::tensors() const {
  const auto numbers = [&](Part which) {
    return std::vector<std::int64_t>{static_cast<std::int64_t>(part_size(which))};
  };
  std::vector<ModelTensor> out = {{"grid", numbers(kFieldGrid), offset(kFieldGrid)}};
  for (int layer = 0; layer < kGridLayers; ++layer) {
    const GridLayerShape shape = grid_layer(field, layer);
    if (shape.outputs > 0)
      out.push_back({shape.name, {shape.outputs, shape.inputs}, offset(kNetwork) + shape.offset});
  }
  out.push_back({"proposal", numbers(kProposalGrid), offset(kProposalGrid)});
  if (sky.n_levels > 0) out.push_back({"sky", numbers(kSkyGrid), offset(kSkyGrid)});
  if (appearance.size() > 0)
    out.push_back({"appearance", {appearance.cameras, appearance.knots, 3}, offset(kAppearance)});
  return out;
}

void GridModel::initialize(std::uint64_t seed) {
  active_fraction = 1;
  parameters = Buffer<float>(size());
  hash_grid_initialize(field.grid, seed, part_of(parameters, kFieldGrid));
  grid_network_initialize(field, seed, part_of(parameters, kNetwork));
}

std::vector<AdamGroup> GridModel::adam_groups(double learning_rate, std::int64_t step) const {
  AdamStep how = adam_step(learning_rate, step);
  how.beta2 = beta2;
  how.epsilon = epsilon;
  how.lazy = true;  // skips table rows that no sample touched
  how.bias2 = static_cast<float>(1 / (1 - std::pow(double(beta2), static_cast<double>(step))));
  return {{0, size(), how}};
}

}  // namespace redrive
