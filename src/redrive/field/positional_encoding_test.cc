// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/positional_encoding.h"

#include <numbers>
#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/field/nerf_field.h"

namespace redrive {
namespace {

constexpr double kPi = std::numbers::pi;
// sin and cos of an angle a rounded once: |error| <= |a| 2^-53, and a <= 2^9 pi here.
constexpr double kAngleError = 512 * kPi * 0x1p-52;

int sine(int coordinate, int octave, int octaves) {
  return 3 + 2 * (coordinate * octaves + octave);
}

TEST(PositionalEncoding, HandComputedValues) {
  const double p[3] = {0.5, -1.0 / 3, 0};
  std::vector<double> e(encoded_size(2));
  positional_encoding(p, 2, e.data());
  const double root = std::sqrt(3.0) / 2;
  const std::vector<double> expected = {0.5,   -1.0 / 3, 0,            // x y z
                                        1,     0,        0,     -1,    // x: sin cos of pi/2, pi
                                        -root, 0.5,      -root, -0.5,  // y: -pi/3, -2pi/3
                                        0,     1,        0,     1};    // z
  ASSERT_EQ(e.size(), expected.size());
  for (std::size_t i = 0; i < e.size(); ++i) EXPECT_NEAR(e[i], expected[i], 1e-15) << i;
}

TEST(PositionalEncoding, OctavesDoubleTheAngle) {
  constexpr int kOctaves = 10;
  for (double x = -1; x <= 1; x += 0.0371) {
    const double p[3] = {x, 0.3 * x, -x};
    std::vector<double> e(encoded_size(kOctaves));
    positional_encoding(p, kOctaves, e.data());
    for (int d = 0; d < 3; ++d)
      for (int l = 0; l < kOctaves; ++l) {
        const double s = e[sine(d, l, kOctaves)], c = e[sine(d, l, kOctaves) + 1];
        EXPECT_NEAR(s * s + c * c, 1, 4 * 0x1p-53);
        if (l + 1 == kOctaves) continue;
        EXPECT_NEAR(e[sine(d, l + 1, kOctaves)], 2 * s * c, 4 * kAngleError);
        EXPECT_NEAR(e[sine(d, l + 1, kOctaves) + 1], c * c - s * s, 4 * kAngleError);
      }
  }
}

TEST(PositionalEncoding, HasPeriodTwo) {
  const double p[3] = {0.125, -0.375, 0.75}, shifted[3] = {2.125, 1.625, -1.25};
  std::vector<double> a(encoded_size(10)), b(a.size());
  positional_encoding(p, 10, a.data());
  positional_encoding(shifted, 10, b.data());
  for (std::size_t i = 3; i < a.size(); ++i) EXPECT_NEAR(a[i], b[i], 4 * kAngleError);
}

TEST(PositionalEncoding, DerivativeSwapsSineAndCosineTimesTheFrequency) {
  using Jet = ceres::Jet<double, 3>;
  constexpr int kOctaves = 4;
  const Jet p[3] = {Jet(0.21, 0), Jet(-0.83, 1), Jet(0.5, 2)};
  std::vector<Jet> e(encoded_size(kOctaves));
  positional_encoding(p, kOctaves, e.data());
  for (int d = 0; d < 3; ++d)
    for (int l = 0; l < kOctaves; ++l)
      for (int i = 0; i < 3; ++i) {
        const Jet s = e[sine(d, l, kOctaves)], c = e[sine(d, l, kOctaves) + 1];
        const double frequency = i == d ? kPi * (1 << l) : 0;
        EXPECT_NEAR(s.v[i], frequency * c.a, 1e-13);
        EXPECT_NEAR(c.v[i], -frequency * s.a, 1e-13);
      }
}

TEST(PositionalEncoding, AdjointAgreesWithJets) {
  using Jet = ceres::Jet<double, 3>;
  constexpr int kOctaves = 10;
  const double p[3] = {0.21, -0.83, 0.5};
  const Jet jets[3] = {Jet(p[0], 0), Jet(p[1], 1), Jet(p[2], 2)};
  std::vector<double> e(encoded_size(kOctaves)), d_e(e.size());
  std::vector<Jet> jet_e(e.size());
  positional_encoding(p, kOctaves, e.data());
  positional_encoding(jets, kOctaves, jet_e.data());
  Jet sum(0);  // weights that fall with the frequency, so that every term counts about the same
  for (std::size_t i = 0; i < e.size(); ++i) {
    const int octave = i < 3 ? 0 : static_cast<int>(i - 3) / 2 % kOctaves;
    d_e[i] = (0.5 + 0.03 * static_cast<double>(i % 31)) / (1 << octave);
    sum += Jet(d_e[i]) * jet_e[i];
  }
  double d_point[3];
  positional_encoding_adjoint(e.data(), kOctaves, d_e.data(), d_point);
  for (int d = 0; d < 3; ++d)
    EXPECT_NEAR(d_point[d], sum.v[d], 2 * kOctaves * 2 * kPi * 0x1p-50) << d;
}

}  // namespace
}  // namespace redrive
