// SPDX-License-Identifier: Apache-2.0
#include "redrive/optim/range_loss.h"

#include <cmath>
#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

const std::vector<float> kEdges = {1, 2, 3.5f, 4, 4.25f, 4.5f, 5, 7, 20, 90};
constexpr int kIntervals = 9;

TEST(RangeLoss, IsZeroForWeightsOfTheSurface) {
  // All of a surface at 4.4 m that is known to 1 mm lies in [4.25, 4.5]: nothing before, anything
  // behind.
  const double weights[kIntervals] = {0, 0, 0, 0, 1, 0.3, 0, 0.2, 0.1};
  double d[kIntervals];
  EXPECT_NEAR(range_loss(kEdges.data(), weights, kIntervals, 4.4f, 1e-3f, 1.0, d), 0, 1e-12);
  for (const double x : d) EXPECT_NEAR(x, 0, 1e-6);
}

TEST(RangeLoss, HandComputed) {
  // The surface lies on the edge between [4, 4.25] and [4.25, 4.5], half of it in either; [4.5, 5]
  // begins beyond three spreads.
  double weights[kIntervals] = {0.1, 0, 0, 0.5, 0.25, 0.7, 0, 0, 0}, d[kIntervals];
  const double loss = range_loss(kEdges.data(), weights, kIntervals, 4.25f, 0.01f, 10.0, d);
  EXPECT_NEAR(loss, 0.01 + 0.0625, 1e-7);
  const double expected[kIntervals] = {2, 0, 0, 0, -5, 0, 0, 0, 0};
  for (int i = 0; i < kIntervals; ++i) EXPECT_NEAR(d[i], expected[i], 1e-5) << i;
}

TEST(RangeLoss, SurfaceIsANormalDistribution) {
  // Within one spread lies erf(1 / sqrt(2)) of it.
  const float edges[] = {0, 8, 12, 30};
  const double weights[3] = {0, 0, 0};
  double d[3];
  range_loss(edges, weights, 3, 10.0f, 2.0f, 1.0, d);
  EXPECT_NEAR(-d[1] / 2, std::erf(std::sqrt(0.5)), 1e-6);
  EXPECT_NEAR(-d[0] / 2, (1 - std::erf(std::sqrt(0.5))) / 2, 1e-6);
}

TEST(RangeLoss, DerivativeAgreesWithJets) {
  using Jet = ceres::Jet<double, kIntervals>;
  std::vector<double> weights(kIntervals), d(kIntervals);
  std::vector<Jet> jets(kIntervals), ignored(kIntervals);
  for (int i = 0; i < kIntervals; ++i) {
    weights[i] = 0.2 * random_unit(random_key(5, kStreamTest, 77), i);
    jets[i] = Jet(weights[i], i);
  }
  range_loss(kEdges.data(), weights.data(), kIntervals, 4.3f, 0.5f, 3.0, d.data());
  const Jet loss =
      range_loss(kEdges.data(), jets.data(), kIntervals, 4.3f, 0.5f, Jet(1), ignored.data());
  EXPECT_GT(loss.a, 1e-3);
  for (int i = 0; i < kIntervals; ++i) EXPECT_NEAR(d[i], 3 * loss.v[i], 1e-14) << i;
}

}  // namespace
}  // namespace redrive
