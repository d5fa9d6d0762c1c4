// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <limits>
#include <map>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/methods/grid/tiny_grid_model_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

TEST(GridModel, TensorsTileTheParametersInOrder) {
  for (const int colour_layers : {1, 2}) {
    GridModel model;
    model.field.colour_layers = colour_layers;
    std::size_t offset = 0;
    std::set<std::string> names;
    for (const ModelTensor& tensor : model.tensors()) {
      EXPECT_EQ(tensor.offset, offset) << tensor.name;
      std::size_t size = 1;
      for (const std::int64_t n : tensor.shape) size *= static_cast<std::size_t>(n);
      offset += size;
      EXPECT_TRUE(names.insert(tensor.name).second) << tensor.name;
    }
    EXPECT_EQ(offset, model.size());
    EXPECT_EQ(names.size(), 6u + colour_layers);
    EXPECT_TRUE(names.contains("colour.out.weight"));
  }
}

TEST(GridModel, InitialValuesDependOnTheSeedWithAnEmptyProposalAndAGreySky) {
  GridModel a, b, c;
  for (GridModel* model : {&a, &b, &c}) make_tiny(*model);
  a.initialize(1);
  b.initialize(1);
  c.initialize(2);
  ASSERT_EQ(a.parameters.size(), a.size());
  EXPECT_TRUE(std::ranges::equal(a.parameters.span(), b.parameters.span()));
  EXPECT_FALSE(std::ranges::equal(a.parameters.span(), c.parameters.span()));
  for (const GridModel::Part part : {GridModel::kProposalGrid, GridModel::kSkyGrid})
    for (const float x : a.grid(part).table) ASSERT_EQ(x, 0);
  for (const float x : a.grid(GridModel::kFieldGrid).table) ASSERT_LE(std::abs(x), 1e-4f);
  EXPECT_GT(std::ranges::count_if(a.network().weights, [](float w) { return std::abs(w) > 0.1f; }),
            100);
}

TEST(GridModel, HyperparametersDetermineTheModel) {
  GridModel model;
  model.field = {{4, 8, 5, 900, 13, 0.125f}, 48, 2};
  model.proposal = {3, 1, 7, 300, 12};
  model.sky = {2, 4, 9, 100, 11};
  model.background = 0.75f;
  model.contraction = {{1, -2, 3}, 12, false};
  model.spacing = {0.75f, 500, 8};
  model.proposal_samples = {40, 20};
  model.samples = 10;
  model.appearance = {5, 20, 0.25f};
  model.initial_density = 0.5f;
  model.proposal_opacity_weight = 0.3;
  model.huber_delta = 0.75f;
  model.histogram_padding = 0.25f;
  model.min_proposal_footprint = 0.75f;
  model.sparsity_weight = 0.125f;
  std::set<std::string> names;
  GridModel copy;
  for (const HyperparameterValue& value : hyperparameter_values(model)) {
    EXPECT_TRUE(names.insert(value.what.name).second) << value.what.name << " twice";
    EXPECT_FALSE(value.what.help.empty()) << value.what.name;
    if (!value.what.derived) {
      EXPECT_TRUE(set_hyperparameter(copy, value.what.name, value.text));
    }
  }
  EXPECT_EQ(copy.field, model.field);
  EXPECT_EQ(copy.proposal, model.proposal);
  EXPECT_EQ(copy.sky, model.sky);
  EXPECT_EQ(copy.background, model.background);
  EXPECT_EQ(copy.contraction, model.contraction);
  EXPECT_EQ(copy.spacing.half_m, model.spacing.half_m);
  EXPECT_EQ(copy.proposal_samples, model.proposal_samples);
  EXPECT_EQ(copy.samples, model.samples);
  EXPECT_EQ(copy.appearance.knots, 20);
  EXPECT_EQ(copy.appearance.regulariser_weight, 0.25f);
  EXPECT_EQ(copy.initial_density, 0.5f);
  EXPECT_EQ(copy.proposal_opacity_weight, 0.3);
  EXPECT_EQ(copy.huber_delta, 0.75f);
  EXPECT_EQ(copy.histogram_padding, 0.25f);
  EXPECT_EQ(copy.min_proposal_footprint, 0.75f);
  EXPECT_EQ(copy.sparsity_weight, 0.125f);
  EXPECT_EQ(copy.samples_per_ray(), 40 + 20 + 10);
}

TEST(GridModel, RejectsHyperparametersOutOfRangeByName) {
  const std::pair<const char*, std::vector<std::string>> table[] = {
      {"grid.n_levels", {"0", "17", "7"}},  // 7 x 4 is no multiple of 16
      {"grid.features_per_level", {"1", "3", "16", "-4"}},
      {"grid.base_resolution", {"0", "-16", "2000000"}},
      {"grid.max_resolution", {"15", "2000000"}},
      {"grid.log2_hashmap_size", {"3", "25"}},
      {"grid.min_level_weight", {"-0.1", "1", "nan"}},
      {"width", {"0", "24", "144", "-16", "32.5"}},
      {"colour_layers", {"0", "3"}},
      {"proposal.features_per_level", {"2"}},
      {"proposal.n_levels", {"0", "17"}},
      {"sky.features_per_level", {"1", "8"}},
      {"sky.log2_hashmap_size", {"3", "25"}},
      {"sky.n_levels", {"-1", "17"}},
      {"huber_delta", {"0", "-1", "nan"}},
      {"appearance.cameras", {"1"}},
      {"appearance.knots", {"-1", "1000000"}},
      {"appearance.regulariser_weight", {"-1", "nan"}},
      {"initial_density", {"0", "-1", "nan"}},
      {"background", {"-0.5", "1.5", "nan"}},
      {"contraction.half_m", {"0", "-1", "nan", "inf"}},
      {"near_m", {"1"}},
      {"spacing.half_m", {"0", "-1", "nan"}},
      {"proposal_samples_1", {"0", "1025"}},
      {"proposal_samples_2", {"0", "1025"}},
      {"samples", {"0", "1025"}},
      {"histogram_padding", {"0", "nan"}},
      {"min_proposal_footprint", {"-0.5", "11", "nan"}},
      {"sparsity_weight", {"-0.5", "1.5", "nan"}},
      {"proposal_opacity_weight", {"-1", "nan"}},
      {"range_weight", {"-1", "nan"}},
      {"rays_per_proposal_ray", {"0"}},
      {"adam.beta2", {"1"}},
      {"batch_rays", {"0", "65537"}},
      {"error_rays", {"-0.1", "0.95"}},
      {"learning_rate", {"0", "2", "fast"}},
  };
  GridModel tiny;
  make_tiny(tiny);
  EXPECT_EQ(error_message_of(tiny), "");
  GridModel usual;
  EXPECT_EQ(error_message_of(usual), "");
  for (const auto& [name, values] : table)
    for (const std::string& value : values) {
      GridModel model;
      try {
        EXPECT_TRUE(set_hyperparameter(model, name, value)) << name;
        EXPECT_THAT(error_message_of(model), HasSubstr(name)) << value;
      } catch (const UsageError& error) {
        EXPECT_THAT(error.what(), HasSubstr(value)) << name;
        EXPECT_THAT(error.what(), testing::AnyOf(HasSubstr("must be"), HasSubstr("cannot be set")));
      }
    }
}

TEST(GridModel, AdamHasTheSettingsOfHashGrids) {
  GridModel model;
  const AdamGroup group = model.adam_groups(0.02, 5).front();
  EXPECT_EQ(group.size, model.size());
  const AdamStep& how = group.step;
  EXPECT_EQ(how.learning_rate, 0.02f);
  EXPECT_EQ(how.beta1, 0.9f);
  EXPECT_EQ(how.beta2, 0.99f);
  EXPECT_EQ(how.epsilon, 1e-15f);
  EXPECT_NEAR(how.bias1, 1 / (1 - std::pow(0.9, 5)), 1e-6);
  EXPECT_NEAR(how.bias2, 1 / (1 - std::pow(0.99, 5)), 1e-4);
}

TEST(GridModel, DrawsMoreRaysWhereFewAreActive) {
  GridModel model;
  for (const auto& [fraction, rays] :
       {std::pair{1.0, 2048}, {0.8, 2560}, {0.5, 4096}, {0.0, 4096}}) {
    model.active_fraction = fraction;
    EXPECT_EQ(model.rays_per_step(), rays);
  }
}

}  // namespace
}  // namespace redrive
