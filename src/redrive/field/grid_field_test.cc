// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/grid_field.h"

#include <set>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(43, kStreamTest, stream), i) - 1;
}

const GridFieldConfig kOneLayer{{8, 4, 16, 2048, 17}, 32, 1},
    kTwoLayers{{8, 4, 16, 2048, 17}, 32, 2};

TEST(GridField, SizesCountedByHand) {
  EXPECT_EQ(grid_network_size(kOneLayer), 32u * 32 + 16 * 32 + 32 * 32 + 3 * 32);
  EXPECT_EQ(grid_network_size(kTwoLayers), grid_network_size(kOneLayer) + 32 * 32);
  EXPECT_EQ(grid_network_size({{16, 2, 16, 512, 17}, 64, 1}),
            64u * 32 + 16 * 64 + 64 * 32 + 3 * 64);
  EXPECT_EQ(grid_macs_per_sample(kTwoLayers), 32 * 32 + 16 * 32 + 2 * 32 * 32 + 3 * 32);
}

TEST(GridField, LayersTileTheBufferInOrder) {
  for (const GridFieldConfig& config :
       {kOneLayer, kTwoLayers, GridFieldConfig{{4, 2, 8, 64, 10}, 128, 2}}) {
    std::size_t offset = 0;
    std::set<std::string> names;
    for (int layer = 0; layer < kGridLayers; ++layer) {
      const GridLayerShape shape = grid_layer(config, layer);
      EXPECT_EQ(shape.offset, offset) << shape.name;
      EXPECT_EQ(shape.outputs == 0, layer == kGridColour1 && config.colour_layers == 1)
          << shape.name;
      offset += static_cast<std::size_t>(shape.outputs) * shape.inputs;
      names.insert(shape.name);
    }
    EXPECT_EQ(offset, grid_network_size(config));
    EXPECT_EQ(names.size(), std::size_t(kGridLayers));
    EXPECT_EQ(grid_layer(config, kGridDensity0).inputs, config.grid.outputs());
    EXPECT_EQ(grid_layer(config, kGridDensity1).outputs, 16);
    EXPECT_EQ(grid_layer(config, kGridColour0).inputs, 16 + 16);
    EXPECT_EQ(grid_layer(config, kGridColourOut).outputs, 3);
  }
}

TEST(GridField, RejectsConfigsOutOfRange) {
  EXPECT_THROW(grid_layer(kOneLayer, kGridLayers), std::logic_error);
  EXPECT_THROW(grid_layer(kOneLayer, -1), std::logic_error);
  for (const int width : {0, 8, 24, 144})
    EXPECT_THROW(grid_network_size({{}, width, 1}), std::logic_error);
  for (const int layers : {0, 3})
    EXPECT_THROW(grid_network_size({{}, 32, layers}), std::logic_error);
}

TEST(GridField, InitialisationIsHeUniformAndFollowsTheSeed) {
  const GridFieldConfig config{{16, 2, 16, 512, 17}, 128, 2};
  std::vector<float> a(grid_network_size(config), 1e9f), b(a.size()), c(a.size());
  grid_network_initialize(config, 1, a);
  grid_network_initialize(config, 1, b);
  grid_network_initialize(config, 2, c);
  EXPECT_EQ(a, b);
  EXPECT_NE(a, c);
  for (int layer = 0; layer < kGridLayers; ++layer) {
    const GridLayerShape shape = grid_layer(config, layer);
    const double bound = std::sqrt(6.0 / shape.inputs), n = double(shape.outputs) * shape.inputs;
    double sum = 0, squares = 0;
    for (std::size_t i = shape.offset; i < shape.offset + std::size_t(n); ++i) {
      EXPECT_LE(std::abs(a[i]), bound * (1 + 1e-6));
      sum += a[i];
      squares += double(a[i]) * a[i];
    }
    // Mean 0 with standard error a / sqrt(3 n); mean square a^2 / 3 with standard error a^2 sqrt(4
    // / 45 n). Five of each.
    EXPECT_NEAR(sum / n, 0, 5 * bound / std::sqrt(3 * n)) << shape.name;
    EXPECT_NEAR(squares / n, bound * bound / 3, 5 * bound * bound * std::sqrt(4 / (45 * n)))
        << shape.name;
  }
  std::vector<float> wrong(a.size() + 1);
  EXPECT_THROW(grid_network_initialize(config, 1, wrong), std::logic_error);
}

/// A network whose weights are set one by one, the others 0, and its result for one sample.
struct ByHand {
  GridFieldConfig config;
  std::vector<double> weights, features, harmonics, d_weights, d_features;
  GridActivations<double> activations;
  double raw[4];

  explicit ByHand(const GridFieldConfig& config)
      : config(config),
        weights(grid_network_size(config)),
        features(config.grid.outputs()),
        harmonics(kHarmonics),
        d_weights(weights.size()),
        d_features(features.size()) {}
  double& weight(int layer, int output, int input) {
    const GridLayerShape shape = grid_layer(config, layer);
    return weights[shape.offset + std::size_t(output) * shape.inputs + input];
  }
  void forward(double density_scale) {
    grid_network_forward(config, weights.data(), features.data(), harmonics.data(), density_scale,
                         &activations, raw);
  }
  void adjoint(const double d_raw[4]) {
    grid_network_adjoint(config, weights.data(), activations, d_raw, d_weights.data(),
                         d_features.data());
  }
};

TEST(GridField, HandComputedSample) {
  for (const int colour_layers : {1, 2}) {
    ByHand net({{2, 2, 8, 16, 10}, 16, colour_layers});
    net.features = {0.5, -2, 3, 0.25};
    net.harmonics[6] = -0.5;
    net.weight(kGridDensity0, 0, 0) = 2;    // hidden 0 = relu(2 x 0.5) = 1
    net.weight(kGridDensity0, 5, 1) = 1;    // hidden 5 = relu(-2) = 0
    net.weight(kGridDensity0, 15, 2) = 1;   // hidden 15 = 3
    net.weight(kGridDensity1, 0, 0) = 0.5;  // g_0 = 0.5
    net.weight(kGridDensity1, 0, 5) = 100;
    net.weight(kGridDensity1, 7, 15) = -2;    // g_7 = -6
    net.weight(kGridColour0, 3, 7) = -0.5;    // 3
    net.weight(kGridColour0, 3, 16 + 6) = 2;  // - 1: colour 3 = 2
    net.weight(kGridColour0, 4, 7) = 1;       // relu(-6) = 0
    net.weight(kGridColour0, 9, 0) = 4;       // colour 9 = 2
    if (colour_layers == 2) {                 // which turns the two about and halves them
      net.weight(kGridColour1, 3, 9) = 0.5;   // 1
      net.weight(kGridColour1, 9, 3) = 0.5;   // 1
      net.weight(kGridColour1, 4, 3) = -1;    // relu(-2) = 0
    }
    net.weight(kGridColourOut, 0, 3) = 1;
    net.weight(kGridColourOut, 1, 9) = -3;
    net.weight(kGridColourOut, 2, 4) = 1000;
    net.forward(0.25);
    const double colour = colour_layers == 1 ? 2 : 1;
    EXPECT_EQ(net.raw[0], colour);
    EXPECT_EQ(net.raw[1], -3 * colour);
    EXPECT_EQ(net.raw[2], 0);
    EXPECT_DOUBLE_EQ(net.raw[3], 0.25 * std::exp(0.5));
  }
}

TEST(GridField, AdjointAgreesWithJets) {
  using Jet = ceres::Jet<double, 1>;
  for (const int colour_layers : {1, 2}) {
    const GridFieldConfig config{{2, 2, 8, 16, 10}, 16, colour_layers};
    ByHand net(config);
    for (std::size_t i = 0; i < net.weights.size(); ++i) net.weights[i] = 0.5 * uniform(1, i);
    for (std::size_t i = 0; i < net.features.size(); ++i) net.features[i] = uniform(2, i);
    for (int i = 0; i < kHarmonics; ++i) net.harmonics[i] = uniform(3, i);
    const double d_raw[4] = {0.7, -1.3, 0.4, 2.1}, scale = 0.3,
                 before = 0.125;  // adjoints are added to it
    std::ranges::fill(net.d_weights, before);
    std::ranges::fill(net.d_features, before);
    net.forward(scale);
    net.adjoint(d_raw);

    std::vector<Jet> weights(net.weights.begin(), net.weights.end()),
        features(net.features.begin(), net.features.end());
    const std::vector<Jet> harmonics(net.harmonics.begin(), net.harmonics.end());
    int changed = 0;
    const auto expect_derivative = [&](Jet* variable, double got, const std::string& which) {
      variable->v[0] = 1;
      GridActivations<Jet> activations;
      Jet raw[4];
      grid_network_forward(config, weights.data(), features.data(), harmonics.data(), Jet(scale),
                           &activations, raw);
      variable->v[0] = 0;
      double expected = before;
      for (int k = 0; k < 4; ++k) expected += d_raw[k] * raw[k].v[0];
      // Four layers of sums of at most 32 terms of order 1.
      EXPECT_NEAR(got, expected, 4 * 32 * 8 * 0x1p-53) << which;
      changed += expected != before;
    };
    for (std::size_t i = 0; i < weights.size(); ++i)
      expect_derivative(&weights[i], net.d_weights[i], "weight " + std::to_string(i));
    EXPECT_GT(changed, static_cast<int>(weights.size() / 4));
    for (std::size_t i = 0; i < features.size(); ++i)
      expect_derivative(&features[i], net.d_features[i], "feature " + std::to_string(i));
  }
}

TEST(GridField, LogDensityIsClampedButItsDerivativeIsNot) {
  for (const double g0 : {-100.0, 14.0, 16.0, 1e4}) {
    ByHand net(kOneLayer);
    net.features[3] = std::abs(g0);
    net.weight(kGridDensity0, 8, 3) = 1;
    net.weight(kGridDensity1, 0, 8) = g0 < 0 ? -1 : 1;
    net.forward(2);
    const double density = 2 * std::exp(std::min(g0, 15.0));
    EXPECT_DOUBLE_EQ(net.raw[3], density);
    const double d_raw[4] = {0, 0, 0, 0.5};
    net.adjoint(d_raw);  // d g_0 / d feature is the sign
    EXPECT_DOUBLE_EQ(net.d_features[3], g0 < 0 ? -0.5 * density : 0.5 * density);
  }
}

TEST(GridField, PropagatesNaN) {
  ByHand net(kOneLayer);
  for (std::size_t i = 0; i < net.weights.size(); ++i) net.weights[i] = uniform(5, i);
  net.features[0] = std::nan("");
  net.forward(1);
  for (const double raw : net.raw) EXPECT_TRUE(std::isnan(raw));
}

}  // namespace
}  // namespace redrive
