// SPDX-License-Identifier: Apache-2.0
#include "redrive/volume/hierarchical_sampling.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

TEST(Stratified, OneSampleInEachBinOfEqualLength) {
  for (const int n : {1, 3, 48, 96, 193}) {
    std::vector<float> t(n), dt(n);
    stratified_ray(n, 1, 10, true, random_key(5, kStreamTest), 1000, t.data(), dt.data());
    // t rounds at most three times (bin, product, sum) of values up to 10.
    const double slack = 4 * 10 * 0x1p-24;
    for (int i = 0; i < n; ++i) {
      EXPECT_GE(t[i], 1 + 9.0 * i / n - slack);
      EXPECT_LE(t[i], 1 + 9.0 * (i + 1) / n + slack);
    }
    for (int i = 0; i + 1 < n; ++i) EXPECT_EQ(dt[i], t[i + 1] - t[i]);
    EXPECT_EQ(dt[n - 1], kInfinity);
  }
}

TEST(Stratified, MiddleOfTheBinWithoutJitter) {
  float t[4], dt[4];
  stratified_ray(4, 2, 10, false, 0, 0, t, dt);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(t[i], 3 + 2.0f * i);  // exact: all are small integers
  for (int i = 0; i < 3; ++i) EXPECT_EQ(dt[i], 2);
}

TEST(Stratified, IsUniformInTheBin) {
  // The bin-relative position is U(0, 1): mean 1/2 (standard error sqrt(1/12 n)), mean square 1/3
  // (sqrt(4/45 n)).
  constexpr int kSamples = 200000;
  std::vector<float> t(kSamples), dt(kSamples);
  double sum = 0, squares = 0;
  for (int ray = 0; ray < kSamples; ++ray) {
    float one, step;
    stratified_ray(1, 0, 1, true, random_key(6, kStreamTest), ray, &one, &step);
    sum += one;
    squares += double(one) * one;
  }
  EXPECT_NEAR(sum / kSamples, 0.5, 5 * std::sqrt(1.0 / 12 / kSamples));
  EXPECT_NEAR(squares / kSamples, 1.0 / 3, 5 * std::sqrt(4.0 / 45 / kSamples));
}

struct Fine {
  std::vector<float> t, dt;
};

Fine draw(const std::vector<float>& coarse, const std::vector<float>& weights, int extra,
          bool jitter) {
  Fine out{std::vector<float>(coarse.size() + extra), std::vector<float>(coarse.size() + extra)};
  hierarchical_ray(coarse.data(), weights.data(), static_cast<int>(coarse.size()), extra, jitter,
                   random_key(9, kStreamTest), 0, out.t.data(), out.dt.data());
  return out;
}

TEST(Hierarchical, AscendsAndContainsTheCoarseSamples) {
  for (const int n : {3, 4, 17, 64})
    for (const int extra : {1, 2, 64, 129}) {
      std::vector<float> coarse(n), dt(n), weights(n);
      stratified_ray(n, 1, 10, true, random_key(n, kStreamTest), 0, coarse.data(), dt.data());
      for (int i = 0; i < n; ++i) weights[i] = random_unit(random_key(n, kStreamTest, 1), i) / n;
      for (const bool jitter : {false, true}) {
        const Fine fine = draw(coarse, weights, extra, jitter);
        EXPECT_TRUE(std::is_sorted(fine.t.begin(), fine.t.end()));
        EXPECT_TRUE(std::includes(fine.t.begin(), fine.t.end(), coarse.begin(), coarse.end()));
        for (std::size_t i = 0; i + 1 < fine.t.size(); ++i)
          EXPECT_EQ(fine.dt[i], fine.t[i + 1] - fine.t[i]);
        EXPECT_EQ(fine.dt.back(), kInfinity);
      }
    }
}

TEST(Hierarchical, EqualWeightsGiveAUniformPdf) {
  // Coarse t = 0..10: the midpoints 0.5 .. 9.5 bound the density, so u = (k + 1/2) / 9 lands on 1,
  // 2, ..., 9.
  std::vector<float> coarse(11), weights(11, 0.1f);
  for (int i = 0; i < 11; ++i) coarse[i] = static_cast<float>(i);
  const Fine fine = draw(coarse, weights, 9, false);
  ASSERT_EQ(fine.t.size(), 20u);
  for (int k = 1; k <= 9; ++k) {
    EXPECT_NEAR(fine.t[2 * k - 1], k, 10 * 0x1p-24);
    EXPECT_NEAR(fine.t[2 * k], k, 10 * 0x1p-24);
  }
}

TEST(Hierarchical, SamplesOnlyTheIntervalWithAllTheMass) {
  std::vector<float> coarse(11), weights(11, 0.0f);
  for (int i = 0; i < 11; ++i) coarse[i] = static_cast<float>(i);
  weights[4] = 1;
  constexpr int kExtra = 1000;
  const Fine fine = draw(coarse, weights, kExtra, true);
  // The other eight intervals hold 1e-5 each: 8e-5 * 1000 draws expect 0.08; strata admit at most
  // one at each end.
  const auto inside =
      std::count_if(fine.t.begin(), fine.t.end(), [](float t) { return t >= 3.5f && t <= 4.5f; });
  EXPECT_GE(inside, kExtra - 2 + 1);
}

TEST(Hierarchical, FollowsThePiecewiseConstantPdf) {
  // Without jitter the k-th draw is the exact quantile (k + 1/2) / extra of the density, hence each
  // interval's share differs from its mass by at most one draw.
  const std::vector<float> coarse = {1, 2, 4, 5, 9, 10},
                           weights = {0.9f, 0.1f, 0.4f, 0.2f, 0.3f, 0.9f};
  constexpr int kExtra = 10000;
  Fine fine = draw(coarse, weights, kExtra, false);
  const float edges[] = {1.5f, 3, 4.5f, 7, 9.5f};
  for (int i = 0; i < 4; ++i) {
    const auto count = std::count_if(fine.t.begin(), fine.t.end(), [&](float t) {
      return t > edges[i] && t <= edges[i + 1] &&
             std::find(coarse.begin(), coarse.end(), t) == coarse.end();
    });
    EXPECT_NEAR(static_cast<double>(count), kExtra * (weights[i + 1] + 1e-5) / (1.0 + 4e-5), 2)
        << i;
  }
}

TEST(Hierarchical, ZeroWeightsGiveAUniformPdf) {
  const std::vector<float> coarse = {0, 1, 2, 3}, weights(4, 0.0f);
  const Fine fine =
      draw(coarse, weights, 4, false);  // quantiles of [0.5, 2.5]: 0.75, 1.25, 1.75, 2.25
  const std::vector<float> expected = {0, 0.75f, 1, 1.25f, 1.75f, 2, 2.25f, 3};
  for (int i = 0; i < 8; ++i) EXPECT_NEAR(fine.t[i], expected[i], 4 * 0x1p-24);
}

TEST(Hierarchical, TerminatesForNonFiniteWeights) {
  const std::vector<float> coarse = {0, 1, 2, 3}, weights(4, std::nanf(""));
  const Fine fine = draw(coarse, weights, 4, true);
  EXPECT_EQ(std::count_if(fine.t.begin(), fine.t.end(), [](float t) { return std::isnan(t); }), 4);
}

}  // namespace
}  // namespace redrive
