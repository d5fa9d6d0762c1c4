// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/appearance.h"

#include <cmath>
#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

constexpr AppearanceConfig kConfig{2, 3};
constexpr int kSize = 18;

std::vector<double> parameters() {
  std::vector<double> p(kSize);
  for (int i = 0; i < kSize; ++i) p[i] = 4 * random_unit(random_key(8, kStreamTest, 1), i) - 2;
  return p;
}

TEST(Appearance, GainsAreOneWithoutACameraAndForZeroParameters) {
  const std::vector<double> p = parameters(), zero(kSize);
  for (const auto& gains :
       {colour_gains(kConfig, p.data(), {-1, 0.3f}), colour_gains({}, p.data(), {1, 0.3f}),
        colour_gains(kConfig, zero.data(), {1, 0.3f})})
    for (const double gain : gains) EXPECT_EQ(gain, 1);
}

TEST(Appearance, LogGainsAreLinearBetweenKnotsAndConstantBeyond) {
  const std::vector<double> p = parameters();
  const auto log_gain = [&](int camera, double knots, int k) {
    return std::log(colour_gains(kConfig, p.data(),
                                 {camera, static_cast<float>(knots * kKnotSpacing_s)})[k]) /
           kLogGainScale;
  };
  for (int camera = 0; camera < 2; ++camera)
    for (int k = 0; k < 3; ++k) {
      const double* const of = &p[9 * camera + k];
      EXPECT_NEAR(log_gain(camera, 1, k), of[3], 1e-12);
      EXPECT_NEAR(log_gain(camera, 1.25, k), 0.75 * of[3] + 0.25 * of[6], 1e-6);
      EXPECT_NEAR(log_gain(camera, 7, k), of[6], 1e-12);
      EXPECT_NEAR(log_gain(camera, -1, k), of[0], 1e-12);
    }
}

TEST(Appearance, AdjointAgreesWithJets) {
  using Jet = ceres::Jet<double, kSize>;
  const std::vector<double> p = parameters();
  std::vector<Jet> jets(kSize);
  for (int i = 0; i < kSize; ++i) jets[i] = Jet(p[i], i);
  const std::array<double, 3> d_gains = {1, -2, 0.5};
  for (const Exposure exposure : {Exposure{0, 0.1f}, {1, 0.9f}, {1, 5}, {-1, 0.5f}}) {
    std::vector<double> d(kSize, 7);
    const auto gains = colour_gains(kConfig, p.data(), exposure);
    colour_gains_adjoint(kConfig, exposure, gains, d_gains,
                         [&](std::size_t at, double x) { d[at] += x; });
    const auto of_jets = colour_gains(kConfig, jets.data(), exposure);
    for (int i = 0; i < kSize; ++i) {
      double expected = 7;
      for (int k = 0; k < 3; ++k) expected += d_gains[k] * of_jets[k].v[i];
      EXPECT_NEAR(d[i], expected, 1e-14) << i;
    }
  }
}

TEST(Appearance, RegulariserIsTheMeanSquareOfLogGains) {
  using Jet = ceres::Jet<double, 1>;
  const std::vector<double> p = parameters();
  double loss = 0, square = 0;
  for (const double parameter : p) {
    const auto term = gain_regulariser(kConfig, Jet(parameter, 0));
    EXPECT_NEAR(term.derivative.a, term.value.v[0], 4 * 0x1p-53 * std::abs(term.value.v[0]));
    loss += term.value.a;
    square += kLogGainScale * parameter * kLogGainScale * parameter / kSize;
  }
  EXPECT_NEAR(loss, kConfig.regulariser_weight * square, 1e-6 * loss) << "the factor is a float";
}

}  // namespace
}  // namespace redrive
