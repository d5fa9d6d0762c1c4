// SPDX-License-Identifier: Apache-2.0
// What a grid model is made of: its numbers, tensors and first values. What it does with them is in
// grid_model.cc.
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/model/grid_model.h"

namespace redrive {

std::size_t GridModel::part_size(int part) const {
  switch (part) {
    case kFieldGrid: return hash_grid_size(field.grid);
    case kNetwork: return grid_network_size(field);
    case kProposalGrid: return hash_grid_size(proposal);
    case kSkyGrid: return sky.levels > 0 ? hash_grid_size(sky) : 0;
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
  return std::to_string(field.grid.levels) + " levels x " + std::to_string(field.grid.features) +
         " of 2^" + std::to_string(field.grid.log2_hashmap_size) + " rows, width " +
         std::to_string(field.width) + ", " + std::to_string(proposal_samples[0]) + " + " +
         std::to_string(proposal_samples[1]) + " + " + std::to_string(samples) + " samples per ray";
}

void GridModel::visit_numbers(NumberVisitor& visit) {
  const auto visit_grid = [&](const std::string& name, HashGridConfig& grid) {
    visit(name + ".levels", grid.levels);
    visit(name + ".features", grid.features);
    visit(name + ".base_cells", grid.base_resolution);
    visit(name + ".max_cells", grid.max_resolution);
    visit(name + ".log2_rows", grid.log2_hashmap_size);
  };
  visit_grid("grid", field.grid);
  visit("width", field.width);
  visit("colour_layers", field.colour_layers);
  visit_grid("proposal", proposal);
  visit_grid("sky", sky);
  visit("background", background);
  visit("huber_edge", huber_delta);
  visit("appearance.cameras", appearance.cameras);
  visit("appearance.knots", appearance.knots);
  visit("contraction.center_x", contraction.center[0]);
  visit("contraction.center_y", contraction.center[1]);
  visit("contraction.center_z", contraction.center[2]);
  visit("contraction.half_m", contraction.half_m);
  int unbounded = contraction.unbounded;
  visit("contraction.unbounded", unbounded);
  contraction.unbounded = unbounded != 0;
  visit("near_m", spacing.near_m);
  visit("far_m", spacing.far_m);
  visit("spacing.half_m", spacing.half_m);
  visit("first_proposals", proposal_samples[0]);
  visit("second_proposals", proposal_samples[1]);
  visit("samples", samples);
  visit("proposal_padding", histogram_padding);
  visit("proposal_width", min_proposal_footprint);
  visit("empty_space", empty_space);
}

void GridModel::check(const std::filesystem::path& file) const {
  const auto require = [&](bool holds, const std::string& field_name, auto value,
                           const char* rule) {
    if (!holds) throw InputError(file, "__metadata__." + field_name, std::to_string(value), rule);
  };
  const auto check_grid = [&](const std::string& name, const HashGridConfig& grid, int features) {
    require(grid.levels >= 1 && grid.levels <= 16, name + ".levels", grid.levels,
            "must be in 1..16");
    if (features > 0)
      require(grid.features == features, name + ".features", grid.features,
              "is another in this method");
    else
      require(grid.features == 2 || grid.features == 4 || grid.features == 8, name + ".features",
              grid.features, "must be 2, 4 or 8");
    require(grid.base_resolution >= 1 && grid.base_resolution <= 1 << 20, name + ".base_cells",
            grid.base_resolution, "must be in 1..2^20");
    require(grid.max_resolution >= grid.base_resolution && grid.max_resolution <= 1 << 20,
            name + ".max_cells", grid.max_resolution, "must be in base_cells..2^20");
    require(grid.log2_hashmap_size >= 4 && grid.log2_hashmap_size <= 24, name + ".log2_rows",
            grid.log2_hashmap_size, "must be in 4..24");
  };
  check_grid("grid", field.grid, 0);
  require(field.grid.outputs() % 16 == 0, "grid.levels", field.grid.levels,
          "times features must be a multiple of 16");
  require(field.width >= 16 && field.width <= kMaxGridWidth && field.width % 16 == 0, "width",
          field.width, "must be a multiple of 16 in 16..128");
  require(field.colour_layers == 1 || field.colour_layers == 2, "colour_layers",
          field.colour_layers, "must be 1 or 2");
  check_grid("proposal", proposal, 1);
  if (sky.levels != 0) check_grid("sky", sky, 4);
  require(background >= 0 && background <= 1, "background", background, "must be in 0..1");
  require(huber_delta > 0, "huber_edge", huber_delta, "must be above 0");
  require(appearance.cameras >= 0 && appearance.cameras <= 1024, "appearance.cameras",
          appearance.cameras, "must be in 0..1024");
  require(appearance.knots >= 0 && appearance.knots <= 100'000, "appearance.knots",
          appearance.knots, "must be in 0..100000");
  require(contraction.half_m > 0, "contraction.half_m", contraction.half_m, "must be above 0");
  require(spacing.near_m > 0, "near_m", spacing.near_m, "must be above 0");
  require(spacing.far_m > spacing.near_m, "far_m", spacing.far_m, "must be above near_m");
  require(spacing.half_m > 0, "spacing.half_m", spacing.half_m, "must be above 0");
  for (const int count : {proposal_samples[0], proposal_samples[1], samples})
    require(count >= 1 && count <= 1024, "samples", count, "must be in 1..1024");
  require(histogram_padding > 0 && histogram_padding <= 1000, "proposal_padding", histogram_padding,
          "must be above 0, up to 1000");
  require(min_proposal_footprint >= 0 && min_proposal_footprint <= 10, "proposal_width",
          min_proposal_footprint, "must be in 0..10");
  require(empty_space >= 0 && empty_space <= 1, "empty_space", empty_space, "must be in 0..1");
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
  if (sky.levels > 0) out.push_back({"sky", numbers(kSkyGrid), offset(kSkyGrid)});
  if (appearance.size() > 0)
    out.push_back({"appearance", {appearance.cameras, appearance.knots, 3}, offset(kAppearance)});
  return out;
}

void GridModel::initialize(std::uint64_t seed) {
  parameters = Buffer<float>(size());
  hash_grid_initialize(field.grid, seed, part_of(parameters, kFieldGrid));
  grid_network_initialize(field, seed, part_of(parameters, kNetwork));
}

AdamStep GridModel::adam(double learning_rate, std::int64_t step) const {
  constexpr float kBeta2 = 0.99f, kEpsilon = 1e-15f;
  AdamStep how = adam_step(learning_rate, step);
  how.beta2 = kBeta2;
  how.epsilon = kEpsilon;
  how.lazy = true;  // a table's rows that no sample came near
  how.bias2 = static_cast<float>(1 / (1 - std::pow(double(kBeta2), static_cast<double>(step))));
  return how;
}

}  // namespace redrive
