// SPDX-License-Identifier: Apache-2.0
// Folding and unfolding against plain loops in double.
#include "redrive/kernels/nerf/cpu/folded_colour.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/rng.h"

namespace redrive::kernels {
namespace {

/// A sum and the sum of the magnitudes of its terms.
struct Sum {
  double value = 0, magnitude = 0;
  void add(double term) {
    value += term;
    magnitude += std::abs(term);
  }
};

std::vector<float> random_numbers(std::size_t n, std::uint64_t stream) {
  std::vector<float> out;
  for (std::size_t i = 0; i < n; ++i)
    out.push_back(2 * random_unit(random_key(5, kStreamTest, stream), i) - 1);
  return out;
}

/// n additions and products, each rounded to 2^-24 of a partial sum, which is at most the sum of
/// the magnitudes.
void expect_near(float got, const Sum& expected, int n, const char* what) {
  ASSERT_NEAR(got, expected.value, (n + 1) * 0x1p-24 * expected.magnitude) << what;
}

class FoldedColourTest : public testing::TestWithParam<NerfConfig> {
 protected:
  void SetUp() override {
    if (const auto obstacle = isa_obstacle(Isa::kAvx2)) GTEST_SKIP() << *obstacle;
  }
};

TEST_P(FoldedColourTest, IsTheProductOfTheLayers) {
  const NerfConfig config = GetParam();
  const NerfLayerShape feature = nerf_layer(config, kNerfFeature),
                       colour = nerf_layer(config, kNerfColour);
  const std::vector<float> p = random_numbers(nerf_parameter_count(config), 1);
  ThreadPool pool(2);
  FoldedColour folded(config);
  const NerfLayerShape shape = folded.shape();
  ASSERT_EQ(shape.outputs, colour.outputs);
  ASSERT_EQ(shape.inputs, colour.inputs);
  for (int time = 0; time < 2; ++time)
    folded.fold(p, pool);  // the second call is independent of the first
  for (int o = 0; o < shape.outputs; ++o) {
    const float* row = &p[colour.weight + static_cast<std::size_t>(o) * colour.inputs];
    const float* got =
        &folded.parameters()[shape.weight + static_cast<std::size_t>(o) * shape.inputs];
    Sum bias;
    bias.add(p[colour.bias + o]);
    for (int j = 0; j < config.width; ++j) bias.add(double{row[j]} * p[feature.bias + j]);
    expect_near(folded.parameters()[shape.bias + o], bias, config.width + 1, "bias");
    for (int i = 0; i < config.width; ++i) {
      Sum sum;
      for (int j = 0; j < config.width; ++j)
        sum.add(double{row[j]} *
                p[feature.weight + static_cast<std::size_t>(j) * config.width + i]);
      expect_near(got[i], sum, config.width, "weight");
    }
    for (int i = config.width; i < shape.inputs; ++i) ASSERT_EQ(got[i], row[i]);
  }
}

TEST_P(FoldedColourTest, UnfoldIsTheAdjointOfFold) {
  const NerfConfig config = GetParam();
  const int width = config.width;
  const NerfLayerShape feature = nerf_layer(config, kNerfFeature),
                       colour = nerf_layer(config, kNerfColour);
  const std::vector<float> p = random_numbers(nerf_parameter_count(config), 1);
  ThreadPool pool(2);
  FoldedColour folded(config);
  const NerfLayerShape shape = folded.shape();
  folded.fold(p, pool);
  const std::vector<float> d = random_numbers(folded.gradients().size(), 2);
  std::copy(d.begin(), d.end(), folded.gradients().begin());
  std::vector<float> gradients(p.size(), 0.0f);
  folded.unfold(gradients, pool);
  for (const float x : folded.gradients()) ASSERT_EQ(x, 0);

  const auto weight = [&](int j, int i) {
    return p[feature.weight + static_cast<std::size_t>(j) * width + i];
  };
  const auto colour_weight = [&](int o, int j) {
    return colour.weight + static_cast<std::size_t>(o) * colour.inputs + j;
  };
  const auto d_folded = [&](int o, int i) {
    return double{d[shape.weight + static_cast<std::size_t>(o) * shape.inputs + i]};
  };
  for (int o = 0; o < shape.outputs; ++o) {
    const double d_bias = d[shape.bias + o];
    ASSERT_EQ(gradients[colour.bias + o], d_bias);
    for (int j = 0; j < width; ++j) {
      Sum sum;
      sum.add(d_bias * p[feature.bias + j]);
      for (int i = 0; i < width; ++i) sum.add(d_folded(o, i) * weight(j, i));
      expect_near(gradients[colour_weight(o, j)], sum, width + 1, "colour.weight");
    }
    for (int i = width; i < shape.inputs; ++i)
      ASSERT_EQ(gradients[colour_weight(o, i)], d_folded(o, i));
  }
  for (int j = 0; j < width; ++j) {
    Sum bias;
    for (int o = 0; o < shape.outputs; ++o)
      bias.add(p[colour_weight(o, j)] * double{d[shape.bias + o]});
    expect_near(gradients[feature.bias + j], bias, shape.outputs, "feature.bias");
    for (int i = 0; i < width; ++i) {
      Sum sum;
      for (int o = 0; o < shape.outputs; ++o) sum.add(p[colour_weight(o, j)] * d_folded(o, i));
      expect_near(gradients[feature.weight + static_cast<std::size_t>(j) * width + i], sum,
                  shape.outputs, "feature.weight");
    }
  }
  // Other layers are unchanged; gradients are added to the previous values.
  double others = 0;
  const std::size_t end = colour.bias + colour.outputs;
  for (std::size_t i = 0; i < p.size(); ++i)
    others += i < feature.weight || i >= end ? std::abs(gradients[i]) : 0;
  EXPECT_EQ(others, 0);
  std::vector<float> twice = gradients;
  std::copy(d.begin(), d.end(), folded.gradients().begin());
  folded.unfold(twice, pool);
  for (std::size_t i = 0; i < twice.size(); ++i) ASSERT_EQ(twice[i], 2 * gradients[i]) << i;
}

INSTANTIATE_TEST_SUITE_P(Widths, FoldedColourTest,
                         testing::Values(NerfConfig{32, 1, 1}, NerfConfig{96, 2, 2},
                                         NerfConfig{256, 10, 4}),
                         [](const auto& info) {
                           return "width" + std::to_string(info.param.width);
                         });

}  // namespace
}  // namespace redrive::kernels
