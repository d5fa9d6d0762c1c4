// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/nerf_field.h"

#include <cmath>
#include <set>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(NerfField, HasTheParameterCountOfThePaper) {
  // Figure 7 with 63 + 27 inputs at width 256: the paper's network with its biases, counted by
  // hand.
  const std::size_t trunk = 63 * 256 + 6 * 256 * 256 + (256 + 63) * 256 + 8 * 256;
  const std::size_t heads =
      (256 + 1) + (256 * 256 + 256) + ((256 + 27) * 128 + 128) + (128 * 3 + 3);
  EXPECT_EQ(nerf_parameter_count(NerfConfig{}), trunk + heads);
  EXPECT_EQ(nerf_parameter_count(NerfConfig{}), 595844u);
  EXPECT_EQ(nerf_macs_per_sample(NerfConfig{}), 593408);
}

TEST(NerfField, TensorsTileTheBufferInOrder) {
  for (const NerfConfig& config : {NerfConfig{}, NerfConfig{32, 1, 1}, NerfConfig{128, 6, 2}}) {
    const auto tensors = nerf_tensors(config);
    ASSERT_EQ(tensors.size(), 2u * kNerfLayers);
    std::size_t offset = 0;
    std::set<std::string> names;
    for (const NerfTensor& tensor : tensors) {
      EXPECT_EQ(tensor.offset, offset) << tensor.name;
      offset += static_cast<std::size_t>(tensor.rows) * tensor.columns;
      names.insert(tensor.name);
    }
    EXPECT_EQ(offset, nerf_parameter_count(config));
    EXPECT_EQ(names.size(), tensors.size());
    EXPECT_TRUE(names.contains("trunk.7.bias"));
    EXPECT_TRUE(names.contains("colour.weight"));
  }
}

TEST(NerfField, SkipAndColourLayersTakeTheEncodings) {
  const NerfConfig config{64, 10, 4};
  EXPECT_EQ(nerf_layer(config, 0).inputs, 63);
  EXPECT_EQ(nerf_layer(config, kNerfSkip).inputs, 64 + 63);
  EXPECT_EQ(nerf_layer(config, kNerfSkip - 1).inputs, 64);
  EXPECT_EQ(nerf_layer(config, kNerfColour).inputs, 64 + 27);
  EXPECT_EQ(nerf_layer(config, kNerfColour).outputs, 32);
  EXPECT_EQ(nerf_layer(config, kNerfRgb).outputs, 3);
  EXPECT_THROW(nerf_layer(config, kNerfLayers), std::logic_error);
}

TEST(NerfField, InitialisationIsGlorotUniform) {
  const NerfConfig config{128, 10, 4};
  std::vector<float> parameters(nerf_parameter_count(config), 1e9f);
  nerf_initialize(config, 7, parameters);
  for (int layer = 0; layer < kNerfLayers; ++layer) {
    const NerfLayerShape shape = nerf_layer(config, layer);
    const double bound = std::sqrt(6.0 / (shape.inputs + shape.outputs));
    const double n = static_cast<double>(shape.bias - shape.weight);
    double sum = 0, squares = 0, largest = 0;
    for (std::size_t i = shape.weight; i < shape.bias; ++i) {
      sum += parameters[i];
      squares += double(parameters[i]) * parameters[i];
      largest = std::max(largest, std::abs(double(parameters[i])));
    }
    EXPECT_LE(largest, bound * (1 + 1e-6));
    // Mean 0 with standard error a / sqrt(3 n); mean square a^2 / 3 with standard error a^2 sqrt(4
    // / 45 n). Five of each.
    EXPECT_NEAR(sum / n, 0, 5 * bound / std::sqrt(3 * n)) << "layer " << layer;
    EXPECT_NEAR(squares / n, bound * bound / 3, 5 * bound * bound * std::sqrt(4 / (45 * n)))
        << "layer " << layer;
    for (int i = 0; i < shape.outputs; ++i) EXPECT_EQ(parameters[shape.bias + i], 0);
  }
}

TEST(NerfField, InitialisationFollowsTheSeed) {
  const NerfConfig config{32, 4, 2};
  std::vector<float> a(nerf_parameter_count(config)), b(a.size()), c(a.size());
  nerf_initialize(config, 1, a);
  nerf_initialize(config, 1, b);
  nerf_initialize(config, 2, c);
  EXPECT_EQ(a, b);
  EXPECT_NE(a, c);
  std::vector<float> wrong(a.size() - 1);
  EXPECT_THROW(nerf_initialize(config, 1, wrong), std::logic_error);
}

}  // namespace
}  // namespace redrive
