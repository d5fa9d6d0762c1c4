// SPDX-License-Identifier: Apache-2.0
#include "redrive/optim/sparsity_loss.h"

#include <cmath>
#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

const std::vector<float> kEdgesOfSpace = {1, 2, 3.5f, 3.5f, 90};
constexpr int kParts = 4;

TEST(SparsityLoss, HandComputed) {
  // Optical depths 0, 3, 0 (of no length) and e - 1.
  const double density[kParts] = {0, 2, 5, (std::exp(1.0) - 1) / 86.5};
  double d[kParts] = {1, 1, 1, 1};
  EXPECT_NEAR(sparsity_loss(kEdgesOfSpace.data(), density, kParts, 10.0, d), std::log(4.0) + 1,
              1e-12);
  const double expected[kParts] = {11, 1 + 15.0 / 4, 1, 1 + 865 / std::exp(1.0)};
  for (int i = 0; i < kParts; ++i) EXPECT_NEAR(d[i], expected[i], 1e-9) << i;
}

TEST(SparsityLoss, DerivativeAgreesWithJets) {
  using Jet = ceres::Jet<double, kParts>;
  const std::vector<double> density = {0.3, 20, 1, 0.01};
  std::vector<double> d(kParts);
  std::vector<Jet> jets(kParts), ignored(kParts);
  for (int i = 0; i < kParts; ++i) jets[i] = Jet(density[i], i);
  sparsity_loss(kEdgesOfSpace.data(), density.data(), kParts, 3.0, d.data());
  const Jet loss = sparsity_loss(kEdgesOfSpace.data(), jets.data(), kParts, Jet(1), ignored.data());
  EXPECT_GT(loss.a, 1);
  for (int i = 0; i < kParts; ++i) EXPECT_NEAR(d[i], 3 * loss.v[i], 1e-12) << i;
}

TEST(SparsityLoss, IsIndependentOfTheUnitOfLength) {
  const float metres[] = {0, 1, 5}, centimetres[] = {0, 100, 500};
  const double per_m[] = {0.5, 2}, per_cm[] = {0.005, 0.02};
  double d[2] = {};
  EXPECT_NEAR(sparsity_loss(metres, per_m, 2, 1.0, d),
              sparsity_loss(centimetres, per_cm, 2, 1.0, d), 1e-12);
}

}  // namespace
}  // namespace redrive
