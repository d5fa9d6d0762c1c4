// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/spherical_harmonics.h"

#include <cmath>
#include <numbers>

#include <ceres/jet.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr double kPi = std::numbers::pi;

struct Direction {
  double polar, azimuth;
  double xyz[3] = {std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth),
                   std::cos(polar)};
};

TEST(SphericalHarmonics, MatchTheDefinitionInTheDocumentedOrder) {
  // sqrt(2) times real and imaginary part of Y_l^m (std::sph_legendre: normalised, with the phase
  // of Condon and Shortley).
  for (const Direction& at :
       {Direction{0.3, 1.1}, {1.2, -2.5}, {2.9, 4.0}, {0, 0}, {kPi, 0}, {kPi / 2, kPi / 3}}) {
    double y[kHarmonics];
    spherical_harmonics(at.xyz, y);
    int i = 0;
    for (int l = 0; l <= 3; ++l)
      for (int m = -l; m <= l; ++m, ++i) {
        const double along = std::sph_legendre(l, std::abs(m), at.polar);
        const double around = m == 0 ? 1
                                     : std::numbers::sqrt2 * (m > 0 ? std::cos(m * at.azimuth)
                                                                    : std::sin(-m * at.azimuth));
        EXPECT_NEAR(y[i], along * around, 1e-15) << "degree " << l << ", order " << m;
      }
    EXPECT_EQ(i, kHarmonics);
  }
}

TEST(SphericalHarmonics, AreOrthonormalOverTheSphere) {
  // Products are polynomials of degree 6: four Gauss-Legendre points along z and eight equal steps
  // around it are exact.
  const double root = 2.0 / 7 * std::sqrt(1.2),
               z[2] = {std::sqrt(3.0 / 7 - root), std::sqrt(3.0 / 7 + root)},
               weight[2] = {(18 + std::sqrt(30.0)) / 36, (18 - std::sqrt(30.0)) / 36};
  double integral[kHarmonics][kHarmonics]{};
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 8; ++j) {
      const Direction at{std::acos(i < 2 ? z[i] : -z[i - 2]), 2 * kPi * j / 8 + 0.1};
      double y[kHarmonics];
      spherical_harmonics(at.xyz, y);
      for (int a = 0; a < kHarmonics; ++a)
        for (int b = 0; b < kHarmonics; ++b)
          integral[a][b] += weight[i % 2] * 2 * kPi / 8 * y[a] * y[b];
    }
  for (int a = 0; a < kHarmonics; ++a)
    for (int b = 0; b < kHarmonics; ++b)
      EXPECT_NEAR(integral[a][b], a == b, 1e-14) << a << " " << b;
}

TEST(SphericalHarmonics, RotationAboutZMixesOrdersPlusAndMinusM) {
  // The derivative of order m along the azimuth is -m times order -m.
  using Jet = ceres::Jet<double, 1>;
  const Direction at{1.0, 0.7};
  double plain[kHarmonics];
  spherical_harmonics(at.xyz, plain);
  Jet turning[3] = {Jet(at.xyz[0]), Jet(at.xyz[1]), Jet(at.xyz[2])}, y[kHarmonics];
  turning[0].v[0] = -at.xyz[1];
  turning[1].v[0] = at.xyz[0];
  spherical_harmonics(turning, y);
  for (int l = 0, i = 0; l <= 3; ++l)
    for (int m = -l; m <= l; ++m, ++i)
      EXPECT_NEAR(y[i].v[0], -m * plain[i - 2 * m], 1e-14) << l << " " << m;
}

}  // namespace
}  // namespace redrive
