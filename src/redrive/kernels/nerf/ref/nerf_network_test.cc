// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/nerf/ref/nerf_network.h"

#include <algorithm>
#include <cmath>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive::kernels::ref {
namespace {

const NerfConfig kConfig{32, 3, 2};
constexpr double kPosition[3] = {0.31, -0.62, 0.17}, kDirection[3] = {0.48, 0.6, 0.64};
constexpr double kWeights[4] = {0.7, -1.1, 0.4, 0.9};  // L = sum kWeights . raw

double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(11, kStreamTest, stream), i) - 1;
}

/// Returns Glorot weights and non-zero biases.
std::vector<double> random_parameters(std::uint64_t seed) {
  std::vector<float> initial(nerf_parameter_count(kConfig));
  nerf_initialize(kConfig, seed, initial);
  std::vector<double> parameters(initial.begin(), initial.end());
  for (std::size_t i = 0; i < parameters.size(); ++i)
    if (parameters[i] == 0) parameters[i] = 0.2 * uniform(seed, i);
  return parameters;
}

template <class T>
T loss(const std::vector<T>& parameters, NerfActivations<T>* activations, const T position[3]) {
  const T direction[3] = {T(kDirection[0]), T(kDirection[1]), T(kDirection[2])};
  T raw[4];
  nerf_sample_forward(kConfig, parameters.data(), position, direction, activations, raw);
  T sum(0);
  for (int k = 0; k < 4; ++k) sum += T(kWeights[k]) * raw[k];
  return sum;
}
template <class T>
T loss(const std::vector<T>& parameters, NerfActivations<T>* activations) {
  const T position[3] = {T(kPosition[0]), T(kPosition[1]), T(kPosition[2])};
  return loss(parameters, activations, position);
}

std::vector<double> gradient(const std::vector<double>& parameters, double* d_position = nullptr) {
  NerfActivations<double> activations;
  loss(parameters, &activations);
  std::vector<double> gradients(parameters.size());
  nerf_sample_adjoint(kConfig, parameters.data(), activations, kWeights, gradients.data(),
                      d_position);
  return gradients;
}

TEST(NerfReference, ZeroWeightsGiveTheBiases) {
  std::vector<double> parameters(nerf_parameter_count(kConfig));
  for (int k = 0; k < 3; ++k) parameters[nerf_layer(kConfig, kNerfRgb).bias + k] = k - 1;
  parameters[nerf_layer(kConfig, kNerfDensity).bias] = -7;
  NerfActivations<double> a;
  double raw[4];
  nerf_sample_forward(kConfig, parameters.data(), kPosition, kDirection, &a, raw);
  EXPECT_EQ(raw[0], -1);
  EXPECT_EQ(raw[1], 0);
  EXPECT_EQ(raw[2], 1);
  EXPECT_EQ(raw[3], -7);
}

TEST(NerfReference, SkipAndDirectionFollowTheLayout) {
  // Weights set by hand: layer 5 copies gamma(x)[j] from behind h into neuron 0, and layers 6 and 7
  // pass it on. The colour layer copies gamma(d)[j] from behind the feature. So density =
  // relu(gamma(x)[j]) and r = relu(gamma(d)[j]).
  std::vector<double> gamma_x(encoded_size(3)), gamma_d(encoded_size(2));
  positional_encoding(kPosition, 3, gamma_x.data());
  positional_encoding(kDirection, 2, gamma_d.data());
  for (int j = 0; j < encoded_size(2); ++j) {
    std::vector<double> parameters(nerf_parameter_count(kConfig));
    parameters[nerf_layer(kConfig, kNerfSkip).weight + kConfig.width + j] = 1;
    for (const int layer : {6, 7, int(kNerfDensity)})
      parameters[nerf_layer(kConfig, layer).weight] = 1;
    parameters[nerf_layer(kConfig, kNerfColour).weight + kConfig.width + j] = 1;
    parameters[nerf_layer(kConfig, kNerfRgb).weight] = 1;
    NerfActivations<double> a;
    double raw[4];
    nerf_sample_forward(kConfig, parameters.data(), kPosition, kDirection, &a, raw);
    EXPECT_EQ(raw[3], std::max(gamma_x[j], 0.0)) << j;
    EXPECT_EQ(raw[0], std::max(gamma_d[j], 0.0)) << j;
    EXPECT_EQ(raw[1], 0);
  }
}

TEST(NerfReference, GradientAgreesWithJetsInEveryTensor) {
  using Jet = ceres::Jet<double, 1>;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    const std::vector<double> parameters = random_parameters(seed),
                              gradients = gradient(parameters);
    for (const NerfTensor& tensor : nerf_tensors(kConfig)) {
      // Directional derivative along a random direction inside this tensor, by Jets.
      std::vector<Jet> jets(parameters.begin(), parameters.end());
      double expected = 0, scale = 0;
      for (std::size_t i = tensor.offset;
           i < tensor.offset + std::size_t(tensor.rows) * tensor.columns; ++i) {
        jets[i].v[0] = uniform(100 + seed, i);
        expected += gradients[i] * jets[i].v[0];
        scale += std::abs(gradients[i] * jets[i].v[0]);
      }
      NerfActivations<Jet> activations;
      EXPECT_GT(scale, 0) << tensor.name << ": nothing tested";
      // Twelve layers of sums over at most 59 inputs, then the sum over the tensor.
      EXPECT_NEAR(loss(jets, &activations).v[0], expected, scale * (12 * 59 + 32 * 59) * 0x1p-53)
          << tensor.name;
    }
  }
}

TEST(NerfReference, PositionGradientAgreesWithJets) {
  using Jet = ceres::Jet<double, 3>;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    const std::vector<double> parameters = random_parameters(seed);
    double d_position[3];
    EXPECT_EQ(gradient(parameters, d_position), gradient(parameters))
        << "the parameters' gradients must not change";
    const Jet position[3] = {Jet(kPosition[0], 0), Jet(kPosition[1], 1), Jet(kPosition[2], 2)};
    NerfActivations<Jet> activations;
    const Jet expected = loss({parameters.begin(), parameters.end()}, &activations, position);
    double scale = 0;
    for (const double d : expected.v) scale = std::max(scale, std::abs(d));
    EXPECT_GT(scale, 0.01) << "nothing tested";
    // Twelve layers of sums over at most 59 inputs: 8e-14 without cancellation, of which at least a
    // tenth remains.
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR(d_position[k], expected.v[k], 10 * 12 * 59 * 0x1p-53 * scale) << k;
  }
}

/// Returns which ReLUs are open.
std::vector<bool> open(const NerfActivations<double>& a) {
  std::vector<bool> pattern;
  for (int layer = 0; layer < kNerfLayers; ++layer)
    if (nerf_layer_has_relu(layer))
      for (const double y : a.output[layer]) pattern.push_back(y > 0);
  return pattern;
}

TEST(NerfReference, GradientAgreesWithDifferencesAwayFromKinks) {
  // Central differences. With all ReLUs fixed, L is a polynomial of degree one in any single
  // parameter, so the only error is rounding, |L| eps / h. Steps that open or close a ReLU are
  // skipped and must be rare.
  const double h = 1e-5;
  const std::vector<double> parameters = random_parameters(4), gradients = gradient(parameters);
  NerfActivations<double> activations;
  loss(parameters, &activations);
  const std::vector<bool> pattern = open(activations);
  int tested = 0, left_out = 0;
  for (std::size_t i = 0; i < parameters.size(); i += 7) {
    std::vector<double> shifted = parameters;
    shifted[i] = parameters[i] + h;
    const double above = loss(shifted, &activations);
    const bool same_above = open(activations) == pattern;
    shifted[i] = parameters[i] - h;
    const double below = loss(shifted, &activations);
    if (!same_above || open(activations) != pattern) {
      ++left_out;
      continue;
    }
    ++tested;
    EXPECT_NEAR(gradients[i], (above - below) / (2 * h), 12 * 59 * 0x1p-53 / h) << i;
  }
  EXPECT_GT(tested, 1000);
  EXPECT_LT(left_out, tested / 100);
}

}  // namespace
}  // namespace redrive::kernels::ref
