// SPDX-License-Identifier: Apache-2.0
// Analytic scenes and gradients of the quadrature.
#include "redrive/volume/composite.h"

#include <algorithm>
#include <limits>
#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr double kWhite = 50;  // sigmoid(50) is 1 in double

double uniform(std::uint64_t stream, std::uint64_t i) {
  return random_unit(random_key(3, kStreamTest, stream), i);
}

/// A ray of `n` random intervals that fill [near, far] exactly: t at their starts.
struct Ray {
  std::vector<float> t, dt;

  Ray(int n, double near_m, double far_m, std::uint64_t seed) {
    std::vector<float> edges = {static_cast<float>(near_m), static_cast<float>(far_m)};
    for (int i = 1; i < n; ++i)
      edges.push_back(static_cast<float>(near_m + (far_m - near_m) * uniform(seed, i)));
    std::sort(edges.begin(), edges.end());
    for (int i = 0; i < n; ++i) {
      t.push_back(edges[i]);
      dt.push_back(edges[i + 1] - edges[i]);
    }
  }
  int n() const { return static_cast<int>(t.size()); }
  double length() const {
    double sum = 0;
    for (const float d : dt) sum += d;
    return sum;
  }
};

std::vector<double> medium(int n, double density, double colour) {
  std::vector<double> raw(4 * n, colour);
  std::fill(raw.begin() + 3 * n, raw.end(), density);
  return raw;
}

RayComposite<double> composite(const Ray& ray, const std::vector<double>& raw,
                               double* weights = nullptr) {
  return composite_ray(raw.data(), ray.n(), ray.t.data(), ray.dt.data(), ray.n(), weights);
}

TEST(Composite, ConstantMediumIsExactForAnySampling) {
  for (const int n : {1, 2, 7, 96})
    for (const double density : {1e-9, 0.03, 1.0, 20.0}) {
      const Ray ray(n, 1, 10, n);
      const auto sum = composite(ray, medium(n, density, 0.4));
      const double opacity = -std::expm1(-density * ray.length());
      // n products and sums of numbers up to 1, each rounded to 2^-53; relative in a thin medium.
      EXPECT_NEAR(sum.opacity, opacity, 8 * n * 0x1p-53 * opacity) << n << " " << density;
      for (int k = 0; k < 3; ++k) EXPECT_NEAR(sum.rgb[k], sigmoid(0.4) * opacity, 8 * n * 0x1p-53);
    }
}

TEST(Composite, WhiteFurnace) {
  // All colours 1: the result is the opacity, for any densities.
  const int n = 64;
  const Ray ray(n, 1, 10, 5);
  auto raw = medium(n, 0, kWhite);
  for (int i = 0; i < n; ++i) raw[3 * n + i] = 3 * uniform(7, i) - 1;
  const auto sum = composite(ray, raw);
  for (int k = 0; k < 3; ++k) EXPECT_DOUBLE_EQ(sum.rgb[k], sum.opacity);
  EXPECT_GT(sum.opacity, 0.5);
  EXPECT_LT(sum.opacity, 1);
}

TEST(Composite, WeightsSumToTheOpacityAndGiveTheDepth) {
  const int n = 33;
  const Ray ray(n, 1, 10, 6);
  auto raw = medium(n, 0, 0);
  for (int i = 0; i < n; ++i) raw[3 * n + i] = 2 * uniform(8, i) - 0.7;
  std::vector<double> weights(n);
  const auto sum = composite(ray, raw, weights.data());
  double opacity = 0, depth = 0, optical_depth = 0;
  for (int i = 0; i < n; ++i) {
    EXPECT_GE(weights[i], 0);
    opacity += weights[i];
    depth += weights[i] * ray.t[i];
    optical_depth += std::max(raw[3 * n + i], 0.0) * ray.dt[i];
  }
  EXPECT_DOUBLE_EQ(sum.opacity, opacity);
  EXPECT_DOUBLE_EQ(sum.depth, depth);
  EXPECT_NEAR(opacity, 1 - std::exp(-optical_depth), 8 * n * 0x1p-53);
}

TEST(Composite, OpacityOfASphereFollowsItsChord) {
  // A sphere of radius r and density sigma at distance 5: opacity 1 - exp(-sigma chord), chord = 2
  // sqrt(r^2 - b^2).
  const double radius = 2, density = 0.8;
  for (const double impact : {0.0, 0.5, 1.9, 2.5})
    for (const int n : {16, 64, 256, 1024}) {
      const Ray ray(n, 1, 10, 40 + n);
      auto raw = medium(n, -1, kWhite);
      double longest = 0;
      for (int i = 0; i < n; ++i) {
        const double x =
            ray.t[i] + 0.5 * ray.dt[i] - 5;  // density is taken at the middle of the interval
        if (x * x + impact * impact < radius * radius) raw[3 * n + i] = density;
        longest = std::max(longest, double(ray.dt[i]));
      }
      const double chord = impact < radius ? 2 * std::sqrt(radius * radius - impact * impact) : 0;
      const auto sum = composite(ray, raw);
      // Only the interval that an end of the chord cuts is counted wrongly, by at most half its
      // length; and d opacity / d chord <= sigma.
      EXPECT_NEAR(sum.opacity, 1 - std::exp(-density * chord), density * longest + 1e-6)
          << impact << " " << n;
      if (impact >= radius) {
        EXPECT_EQ(sum.opacity, 0);
      }
    }
}

TEST(Composite, EmptySpaceIsBlackAndTransparent) {
  Ray ray(8, 1, 10, 1);
  ray.dt.back() = kInfinity;
  for (const double density : {0.0, -5.0}) {
    const auto sum = composite(ray, medium(8, density, kWhite));
    EXPECT_EQ(sum.opacity, 0);
    EXPECT_EQ(sum.depth, 0);
    EXPECT_EQ(sum.rgb[0], 0);
  }
}

TEST(Composite, InfiniteLastIntervalAbsorbsTheRest) {
  Ray ray(8, 1, 10, 2);
  ray.dt.back() = kInfinity;
  const auto raw = medium(8, 0.01, kWhite);
  std::vector<double> weights(8);
  const auto sum = composite(ray, raw, weights.data());
  EXPECT_DOUBLE_EQ(sum.opacity, 1);
  EXPECT_NEAR(weights[7], std::exp(-0.01 * (ray.t[7] - ray.t[0])), 1e-7);
}

TEST(Composite, HugeDensityIsOpaqueAtTheFirstSample) {
  for (const double density : {1e3, 1e12, 1e30}) {
    Ray ray(8, 1, 10, 3);
    ray.dt.back() = kInfinity;
    auto raw = medium(8, density, 0.2);
    std::vector<double> weights(8), d_raw(raw.size());
    const auto sum = composite(ray, raw, weights.data());
    EXPECT_DOUBLE_EQ(sum.opacity, 1);
    EXPECT_NEAR(sum.depth, ray.t[0], 1e-6);
    const double d_rgb[3] = {1, -2, 3};
    composite_ray_adjoint(raw.data(), 8, ray.dt.data(), 8, d_rgb, d_raw.data());
    for (const double d : d_raw) EXPECT_TRUE(std::isfinite(d));
  }
}

TEST(Composite, PropagatesNaN) {
  Ray ray(4, 1, 10, 4);
  ray.dt.back() = kInfinity;
  for (int broken = 0; broken < 4; ++broken) {
    auto raw = medium(4, 0.1, 0);
    raw[3 * 4 + broken] = std::nan("");
    EXPECT_TRUE(std::isnan(composite(ray, raw).opacity)) << broken;
  }
}

/// d_raw of d_rgb . rgb + d_weights . weights by Jets, [4 n].
template <int kSamples>
std::vector<double> gradient_by_jets(const Ray& ray, const std::vector<double>& raw,
                                     const double d_rgb[3], const std::vector<double>& d_weights,
                                     const double background[3]) {
  using Jet = ceres::Jet<double, 4 * kSamples>;
  std::vector<Jet> x(raw.size()), weights(kSamples);
  for (std::size_t i = 0; i < raw.size(); ++i) x[i] = Jet(raw[i], i);
  const Jet behind[3] = {Jet(background[0]), Jet(background[1]), Jet(background[2])};
  const auto sum = composite_ray<Jet>(x.data(), kSamples, ray.t.data(), ray.dt.data(), kSamples,
                                      weights.data(), behind);
  std::vector<double> gradient(raw.size());
  for (std::size_t i = 0; i < raw.size(); ++i) {
    for (int k = 0; k < 3; ++k) gradient[i] += d_rgb[k] * sum.rgb[k].v[i];
    for (int s = 0; s < kSamples; ++s) gradient[i] += d_weights[s] * weights[s].v[i];
  }
  return gradient;
}

TEST(CompositeAdjoint, AgreesWithJets) {
  constexpr int kSamples = 12;
  for (const bool last_infinite : {false, true})
    for (const double density_scale : {1e-6, 0.3, 3.0, 60.0})
      for (std::uint64_t seed = 0; seed < 5; ++seed) {
        Ray ray(kSamples, 1, 10, 100 + seed);
        if (last_infinite) ray.dt.back() = kInfinity;
        std::vector<double> raw(4 * kSamples), d_raw(raw.size());
        for (int i = 0; i < 3 * kSamples; ++i) raw[i] = 6 * uniform(200 + seed, i) - 3;
        for (int i = 0; i < kSamples; ++i)
          raw[3 * kSamples + i] = density_scale * (uniform(300 + seed, i) - 0.3);
        const double d_rgb[3] = {0.7, -1.3, 0.2};
        std::vector<double> d_weights(kSamples);
        for (int i = 0; i < kSamples; ++i) d_weights[i] = 2 * uniform(400 + seed, i) - 1;
        const double background[3] = {0.2, 0.9, 0.5};
        composite_ray_adjoint(raw.data(), kSamples, ray.dt.data(), kSamples, d_rgb, d_raw.data(),
                              d_weights.data(), background);
        const auto expected = gradient_by_jets<kSamples>(ray, raw, d_rgb, d_weights, background);
        // Sums of 3 x kSamples terms, each at most dt (|d_rgb| + 1); every term a product of at
        // most kSamples + 4 factors.
        const double scale = 9 * 3.2;
        for (std::size_t i = 0; i < raw.size(); ++i)
          EXPECT_NEAR(d_raw[i], expected[i], scale * 3 * kSamples * (kSamples + 4) * 0x1p-53) << i;
      }
}

TEST(CompositeAdjoint, IsAccurateForAThinMediumInFloat) {
  // w = T_i - T_{i+1} would leave nothing of sigma dt = 1e-7 in float; w = T_i alpha_i keeps it to
  // a few ulp.
  const int n = 4;
  const std::vector<float> dt(n, 1.0f);
  std::vector<float> raw(4 * n, 0.5f), d_raw(raw.size());
  std::fill(raw.begin() + 3 * n, raw.end(), 1e-7f);
  const float d_rgb[3] = {1, 1, 1};
  composite_ray_adjoint(raw.data(), n, dt.data(), n, d_rgb, d_raw.data());
  const double c = sigmoid(0.5);
  for (int i = 0; i < n; ++i) {
    const double expected = 1e-7f * std::exp(-1e-7 * i) * c * (1 - c);
    EXPECT_NEAR(d_raw[i], expected, expected * 16 * 0x1p-24);
  }
}

}  // namespace
}  // namespace redrive
