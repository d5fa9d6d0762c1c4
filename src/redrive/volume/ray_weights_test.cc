// SPDX-License-Identifier: Apache-2.0
#include "redrive/volume/ray_weights.h"

#include <numeric>
#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/volume/composite.h"

namespace redrive {
namespace {

double uniform(std::uint64_t stream, std::uint64_t i) {
  return random_unit(random_key(4, kStreamTest, stream), i);
}

std::vector<float> random_edges(int n, std::uint64_t seed) {
  std::vector<float> edges = {0.5f};
  for (int i = 0; i < n; ++i) edges.push_back(edges.back() + static_cast<float>(uniform(seed, i)));
  return edges;
}

TEST(RayWeights, ConstantMediumIsExactForAnyIntervals) {
  for (const int n : {1, 2, 7, 64})
    for (const double density : {1e-9, 0.03, 1.0, 20.0}) {
      const std::vector<float> edges = random_edges(n, n);
      std::vector<double> weights(n);
      ray_weights(edges.data(), std::vector<double>(n, density).data(), n, weights.data());
      double begin = 0;  // exp(-density begin) - exp(-density end); a length is the difference of
                         // two floats, rounded to one
      for (int i = 0; i < n; ++i) {
        const double length = edges[i + 1] - edges[i];
        const double expected = std::exp(-density * begin) * -std::expm1(-density * length);
        EXPECT_NEAR(weights[i], expected, (8 * n + 2 * density * begin) * 0x1p-53 * expected)
            << i << " of " << n;
        begin += length;
      }
      EXPECT_NEAR(std::accumulate(weights.begin(), weights.end(), 0.0),
                  -std::expm1(-density * begin), 8 * n * 0x1p-53);
    }
}

TEST(RayWeights, MatchCompositing) {
  const int n = 33;
  const std::vector<float> edges = random_edges(n, 100);
  std::vector<float> t, dt;
  std::vector<double> raw(4 * n), weights(n), composited(n);
  for (int i = 0; i < n; ++i) {
    t.push_back(edges[i]);
    dt.push_back(edges[i + 1] - edges[i]);
    raw[3 * n + i] = i % 5 == 0 ? 0 : 3 * uniform(101, i);
  }
  ray_weights(edges.data(), &raw[3 * n], n, weights.data());
  composite_ray(raw.data(), n, t.data(), dt.data(), n, composited.data());
  EXPECT_EQ(weights, composited);
}

TEST(RayWeights, OpaqueWallsAndEmptySpace) {
  const std::vector<float> edges = {1, 2, 2, 3, 4};
  const std::vector<double> density = {0, 1e30, 1e30, 1e30};
  std::vector<double> weights(4), d_density(4);
  ray_weights(edges.data(), density.data(), 4, weights.data());
  EXPECT_EQ(weights, (std::vector<double>{0, 0, 1, 0}));  // the second is of no length
  const std::vector<double> d_weights = {1, 2, 3, 5};
  ray_weights_adjoint(edges.data(), density.data(), 4, weights.data(), d_weights.data(),
                      d_density.data());
  // Weight gained before the wall is lost by the wall; density in and behind it changes nothing.
  EXPECT_EQ(d_density, (std::vector<double>{1 - 3, 0, 0, 0}));
}

TEST(RayWeightsAdjoint, AgreesWithJets) {
  constexpr int kIntervals = 12;
  using Jet = ceres::Jet<double, kIntervals>;
  for (const double scale : {1e-6, 0.3, 3.0, 60.0})
    for (std::uint64_t seed = 0; seed < 5; ++seed) {
      const std::vector<float> edges = random_edges(kIntervals, 200 + seed);
      std::vector<double> density(kIntervals), weights(kIntervals), d_weights(kIntervals),
          d_density(kIntervals, NAN);
      std::vector<Jet> x(kIntervals), w(kIntervals);
      for (int i = 0; i < kIntervals; ++i) {
        density[i] = i == 4 ? 0 : scale * uniform(300 + seed, i);
        d_weights[i] = 2 * uniform(400 + seed, i) - 1;
        x[i] = Jet(density[i], i);
      }
      ray_weights(edges.data(), x.data(), kIntervals, w.data());
      ray_weights(edges.data(), density.data(), kIntervals, weights.data());
      ray_weights_adjoint(edges.data(), density.data(), kIntervals, weights.data(),
                          d_weights.data(), d_density.data());
      for (int i = 0; i < kIntervals; ++i) {
        double expected = 0;
        for (int j = 0; j < kIntervals; ++j) expected += d_weights[j] * w[j].v[i];
        // Sums of at most 12 terms below 1, each of at most 12 factors, one of them an exponential
        // of an argument up to 60 x 12.
        EXPECT_NEAR(d_density[i], expected, 12 * (2 * 12 + 2 * scale * 12) * 0x1p-53) << i;
      }
    }
}

TEST(RayWeightsAdjoint, IsAccurateForAThinMediumInFloat) {
  // 1 - exp(-1e-7) would have no digits left in float.
  const int n = 4;
  const std::vector<float> edges = {1, 2, 3, 4, 5}, density(n, 1e-7f), d_weights = {1, 2, -1, 3};
  std::vector<float> weights(n), d_density(n);
  ray_weights(edges.data(), density.data(), n, weights.data());
  for (int i = 0; i < n; ++i) {
    const double expected = 1e-7f * std::exp(-1e-7 * (i + 0.5));
    EXPECT_NEAR(weights[i], expected, 4 * n * 0x1p-24 * expected);
  }
  ray_weights_adjoint(edges.data(), density.data(), n, weights.data(), d_weights.data(),
                      d_density.data());
  // Exact except for the medium's absorption, 4e-7 of numbers up to 3, before and behind each
  // interval.
  for (int i = 0; i < n; ++i) EXPECT_NEAR(d_density[i], d_weights[i], 2e-6);
}

}  // namespace
}  // namespace redrive
