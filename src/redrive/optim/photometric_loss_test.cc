// SPDX-License-Identifier: Apache-2.0
#include "redrive/optim/photometric_loss.h"

#include <ceres/jet.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(Photometric, IsTheMeanSquaredErrorOfTheBatch) {
  // Two rays: errors 1, 0, 0, 0.5, -0.5, 0: (1 + 0.25 + 0.25) / 6 = 0.25, exact in binary up to the
  // sixth.
  const double rendered[6] = {1, 0.25, 0.5, 1, 0, 0.75}, target[6] = {0, 0.25, 0.5, 0.5, 0.5, 0.75};
  double loss = 0;
  for (int i = 0; i < 6; ++i) loss += photometric_term(rendered[i], target[i], 2).value;
  EXPECT_DOUBLE_EQ(loss, 0.25);
}

TEST(Photometric, BatchLossIsTheSumOfItsTerms) {
  const float rendered[6] = {1, 0.25, 0.5, 1, 0, 0.75}, target[6] = {0, 0.25, 0.5, 0.5, 0.5, 0.75};
  float d_rgb[6];
  EXPECT_DOUBLE_EQ(photometric_batch(rendered, target, 2, d_rgb), 0.25);
  for (int i = 0; i < 6; ++i)
    EXPECT_FLOAT_EQ(d_rgb[i], photometric_term(rendered[i], target[i], 2).derivative);
}

TEST(Photometric, DerivativeAgreesWithJets) {
  using Jet = ceres::Jet<double, 1>;
  for (const double rendered : {-0.2, 0.0, 0.4, 1.0})
    for (const double target : {0.0, 0.4, 1.0}) {
      const auto term = photometric_term(Jet(rendered, 0), Jet(target), 7);
      EXPECT_NEAR(term.derivative.a, term.value.v[0], 4 * 0x1p-53);
    }
}

TEST(Huber, IsQuadraticUpToDeltaAndLinearBeyond) {
  EXPECT_EQ(huber_term(0.0625, 0.5).value, 0.0625);
  EXPECT_EQ(huber_term(0.0625, 0.5).factor, 1);
  EXPECT_DOUBLE_EQ(huber_term(0.25, 0.5).value, 0.25);
  EXPECT_DOUBLE_EQ(huber_term(2.25, 0.5).value, 1.25) << "a distance of 1.5: 0.25 + 2 x 0.5 x 1";
  EXPECT_TRUE(std::isnan(huber_term(std::nan(""), 0.5).value));
}

TEST(Huber, FactorIsTheDerivativeByTheSquaredError) {
  using Jet = ceres::Jet<double, 1>;
  for (const double square : {0.01, 0.2, 0.3, 2.0}) {
    const auto term = huber_term(Jet(square, 0), Jet(0.5));
    EXPECT_NEAR(term.factor.a, term.value.v[0], 4 * 0x1p-53);
  }
}

}  // namespace
}  // namespace redrive
