// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <limits>
#include <map>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/model/tiny_grid_model_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

/// Numbers by name, read and written.
class Numbers final : public NumberVisitor {
 public:
  explicit Numbers(GridModel& model) : model_(model) { model.visit_numbers(*this); }
  void set(const std::string& name, double value) {
    ASSERT_TRUE(values.contains(name)) << name;
    values[name] = value;
    writing_ = true;
    model_.visit_numbers(*this);
  }
  void operator()(const std::string& name, int& value) override { visit(name, value); }
  void operator()(const std::string& name, float& value) override { visit(name, value); }

  std::map<std::string, double> values;
  int visited = 0;

 private:
  template <class T>
  void visit(const std::string& name, T& value) {
    ++visited;
    if (writing_)
      value = static_cast<T>(values.at(name));
    else
      values[name] = value;
  }
  GridModel& model_;
  bool writing_ = false;
};

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

TEST(GridModel, StartFollowsTheSeedWithAnEmptyProposalAndAGreySky) {
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

TEST(GridModel, NumbersAreAllThatItIsMadeOf) {
  GridModel model;
  model.field = {{4, 8, 5, 900, 13}, 48, 2};
  model.proposal = {3, 1, 7, 300, 12};
  model.sky = {2, 4, 9, 100, 11};
  model.background = 0.75f;
  model.contraction = {{1, -2, 3}, 12, false};
  model.spacing = {0.75f, 500, 8};
  model.proposal_samples = {40, 20};
  model.samples = 10;
  model.appearance = {5, 20};
  model.huber_delta = 0.75f;
  model.histogram_padding = 0.25f;
  model.min_proposal_footprint = 0.75f;
  model.empty_space = 0.125f;
  const Numbers numbers(model);
  EXPECT_EQ(numbers.visited, static_cast<int>(numbers.values.size())) << "two of one name";
  GridModel copy;
  Numbers of_copy(copy);
  for (const auto& [name, value] : numbers.values) of_copy.set(name, value);
  EXPECT_EQ(copy.field, model.field);
  EXPECT_EQ(copy.proposal, model.proposal);
  EXPECT_EQ(copy.sky, model.sky);
  EXPECT_EQ(copy.background, model.background);
  EXPECT_EQ(copy.contraction, model.contraction);
  EXPECT_EQ(copy.spacing.near_m, model.spacing.near_m);
  EXPECT_EQ(copy.spacing.far_m, model.spacing.far_m);
  EXPECT_EQ(copy.spacing.half_m, model.spacing.half_m);
  EXPECT_EQ(copy.proposal_samples, model.proposal_samples);
  EXPECT_EQ(copy.samples, model.samples);
  EXPECT_EQ(copy.appearance.size(), 3u * 5 * 20);
  EXPECT_EQ(copy.huber_delta, 0.75f);
  EXPECT_EQ(copy.histogram_padding, 0.25f);
  EXPECT_EQ(copy.min_proposal_footprint, 0.75f);
  EXPECT_EQ(copy.empty_space, 0.125f);
  EXPECT_EQ(copy.size(), model.size());
  EXPECT_EQ(copy.samples_per_ray(), 40 + 20 + 10);
}

TEST(GridModel, NumbersOutOfRangeAreRefusedByName) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const std::pair<const char*, std::vector<double>> table[] = {
      {"grid.levels", {0, 17, 7}},  // 7 x 4 is no multiple of 16
      {"grid.features", {1, 3, 16, -4}},  {"grid.base_cells", {0, -16, 2e6}},
      {"grid.max_cells", {15, 2e6}},      {"grid.log2_rows", {3, 25}},
      {"width", {0, 24, 144, -16}},       {"colour_layers", {0, 3}},
      {"proposal.features", {2}},         {"proposal.levels", {0, 17}},
      {"sky.features", {1, 8}},           {"sky.log2_rows", {3, 25}},
      {"huber_edge", {0, -1, kNan}},      {"appearance.cameras", {-1, 1025}},
      {"appearance.knots", {-1, 1e6}},    {"sky.levels", {-1, 17}},
      {"background", {-0.5, 1.5, kNan}},  {"contraction.half_m", {0, -1, kNan}},
      {"near_m", {0, -1, kNan}},          {"far_m", {0.5, kNan}},
      {"spacing.half_m", {0, -1, kNan}},  {"first_proposals", {0, 1025}},
      {"second_proposals", {0, 1025}},    {"samples", {0, 1025}},
      {"proposal_padding", {0, kNan}},    {"proposal_width", {-0.5, 11, kNan}},
      {"empty_space", {-0.5, 1.5, kNan}},
  };
  GridModel tiny;
  make_tiny(tiny);
  EXPECT_NO_THROW(tiny.check("c"));
  EXPECT_NO_THROW(GridModel().check("c"));
  for (const auto& [name, values] : table)
    for (const double value : values) {
      GridModel model;
      Numbers(model).set(name, value);
      try {
        model.check("run/checkpoint.safetensors");
        ADD_FAILURE() << name << " = " << value << " was taken";
      } catch (const InputError& error) {
        EXPECT_THAT(error.what(), HasSubstr("run/checkpoint.safetensors"));
        const std::string field =
            std::string(name).find("proposals") == std::string::npos ? name : "samples";
        EXPECT_THAT(error.what(), HasSubstr("__metadata__." + field)) << name;
      }
    }
}

TEST(GridModel, AdamIsTheOneOfHashGrids) {
  const AdamStep how = GridModel().adam(0.02, 5);
  EXPECT_EQ(how.learning_rate, 0.02f);
  EXPECT_EQ(how.beta1, 0.9f);
  EXPECT_EQ(how.beta2, 0.99f);
  EXPECT_EQ(how.epsilon, 1e-15f);
  EXPECT_NEAR(how.bias1, 1 / (1 - std::pow(0.9, 5)), 1e-6);
  EXPECT_NEAR(how.bias2, 1 / (1 - std::pow(0.99, 5)), 1e-4);
}

}  // namespace
}  // namespace redrive
