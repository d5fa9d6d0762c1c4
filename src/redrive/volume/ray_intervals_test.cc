// SPDX-License-Identifier: Apache-2.0
#include "redrive/volume/ray_intervals.h"

#include <algorithm>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr double kRoundoff = 0x1p-24;

std::vector<float> uniform_edges_of(const RaySpacing& spacing, int n, bool jitter = false,
                                    std::uint64_t ray = 0) {
  std::vector<float> edges(n + 1);
  uniform_edges(spacing, n, jitter, random_key(7, kStreamTest), ray, edges.data());
  return edges;
}

constexpr float kPadding = 0.01f;

std::vector<float> proposed(const std::vector<float>& edges, const std::vector<float>& weights,
                            int to, bool jitter = false, std::uint64_t ray = 0) {
  std::vector<float> out(to + 1);
  pdf_edges(edges.data(), weights.data(), static_cast<int>(weights.size()), to, kPadding, jitter,
            random_key(8, kStreamTest), ray, out.data());
  return out;
}

TEST(UniformEdges, AreEvenlySpacedInS) {
  for (const RaySpacing& spacing :
       {RaySpacing{0.5f, 1000, 20}, RaySpacing{2, 50, 5}, RaySpacing{0.125f, 8, 1000}})
    for (const int n : {1, 2, 7, 64}) {
      const std::vector<float> edges = uniform_edges_of(spacing, n);
      const auto s = [&](double t) { return t / (t + spacing.half_m); };
      const double first = s(spacing.near_m), last = s(spacing.far_m);
      for (int i = 0; i <= n; ++i) {
        // s is at most 1 and is rounded six times; the roundings of 1 - s and of t change s by no
        // more.
        EXPECT_NEAR(s(edges[i]), first + (last - first) * i / n, 8 * kRoundoff) << i << " of " << n;
      }
    }
}

TEST(UniformEdges, HalfOfThemLieWithinHalfM) {
  const std::vector<float> edges = uniform_edges_of({0, 1e6f, 20}, 64);
  EXPECT_EQ(edges[0], 0);
  EXPECT_NEAR(edges[32], 20, 20 * 4.1e-5);  // s(1e6) is 2e-5 short of 1, and dt/ds is 80 at s = 1/2
  EXPECT_GT(edges[64], 9e5);
}

TEST(UniformEdges, InfiniteHalfMIsUniformInDistance) {
  const std::vector<float> edges = uniform_edges_of({2, 10, kInfinity}, 4);
  EXPECT_EQ(edges, (std::vector<float>{2, 4, 6, 8, 10}));
}

TEST(UniformEdges, JitterShiftsAllInnerEdgesByOneFraction) {
  // Evenly in distance, from 0, n = 4 intervals of length 1: edge i is at i + shift, shift ~
  // U(-1/2, 1/2).
  constexpr int kRays = 100000;
  double sum = 0, squares = 0;
  for (int ray = 0; ray < kRays; ++ray) {
    const std::vector<float> edges = uniform_edges_of({0, 4, kInfinity}, 4, true, ray);
    ASSERT_EQ(edges[0], 0);
    ASSERT_EQ(edges[4], 4);
    const double shift = edges[1] - 1.0;
    ASSERT_GE(shift, -0.5);
    ASSERT_LT(shift, 0.5);
    for (int i = 2; i < 4; ++i) ASSERT_NEAR(edges[i] - i, shift, 8 * kRoundoff);
    sum += shift;
    squares += shift * shift;
  }
  // Mean 0 with standard error sqrt(1/12 n), mean square 1/12 with sqrt(1/180 n). Five of each.
  EXPECT_NEAR(sum / kRays, 0, 5 * std::sqrt(1.0 / 12 / kRays));
  EXPECT_NEAR(squares / kRays, 1.0 / 12, 5 * std::sqrt(1.0 / 180 / kRays));
}

TEST(UniformEdges, AscendForAnyJitter) {
  for (const int n : {1, 2, 3, 64})
    for (std::uint64_t ray = 0; ray < 1000; ++ray) {
      const std::vector<float> edges = uniform_edges_of({0.5f, 1000, 20}, n, true, ray);
      ASSERT_TRUE(std::is_sorted(edges.begin(), edges.end()));
      EXPECT_EQ(edges.front(), uniform_edges_of({0.5f, 1000, 20}, n).front());
      EXPECT_EQ(edges.back(), uniform_edges_of({0.5f, 1000, 20}, n).back());
    }
}

/// How much of the histogram with its padding lies before t, 0..1.
double share_before(const std::vector<float>& edges, const std::vector<float>& weights, double t) {
  double total = 0, before = 0;
  for (const float w : weights) total += w;
  const double n = static_cast<double>(weights.size()),
               padding = (total > 0 ? total : 1) * kPadding / n;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const double inside = std::clamp((t - edges[i]) / (double(edges[i + 1]) - edges[i]), 0.0, 1.0);
    before += inside * (weights[i] + padding);
  }
  return before / (total + n * padding);
}

TEST(PdfEdges, HandComputedQuantiles) {
  // One interval holds 1 of 1.01, four hold 0.0025 of padding each. Quarters: 0.2525, 0.505,
  // 0.7575, of which 0.0025 lie before it.
  const std::vector<float> out = proposed({0, 1, 3, 4, 8}, {0, 1, 0, 0}, 4);
  EXPECT_EQ(out.front(), 0);
  EXPECT_EQ(out.back(), 8);
  for (int k = 1; k < 4; ++k)
    EXPECT_NEAR(out[k], 1 + 2 * (0.2525 * k - 0.0025) / 1.0025, 16 * kRoundoff) << k;
}

TEST(PdfEdges, EqualWeightsOfEqualIntervalsGiveEqualIntervals) {
  const std::vector<float> edges = {2, 3, 4, 5, 6, 7, 8, 9, 10}, weights(8, 0.125f);
  for (const int to : {1, 2, 4, 16}) {
    const std::vector<float> out = proposed(edges, weights, to);
    for (int k = 0; k <= to; ++k)
      EXPECT_NEAR(out[k], 2 + 8.0 * k / to, 16 * 10 * kRoundoff) << k << " of " << to;
  }
}

/// Random edges and weights, some of them 0.
struct Histogram {
  std::vector<float> edges, weights;

  Histogram(int n, std::uint64_t seed) {
    float t = 0.5f;
    for (int i = 0; i < n; ++i) {
      edges.push_back(t);
      t += 0.01f + std::exp2(6 * random_unit(random_key(seed, kStreamTest, 1), i));
      const float w = random_unit(random_key(seed, kStreamTest, 2), i);
      weights.push_back(w < 0.3f ? 0 : w / static_cast<float>(n));
    }
    edges.push_back(t);
  }
};

TEST(PdfEdges, LieAtUniformQuantiles) {
  for (const int n : {1, 3, 32, 64})
    for (const int to : {1, 2, 24, 32})
      for (std::uint64_t seed = 0; seed < 20; ++seed) {
        const Histogram h(n, seed);
        const std::vector<float> out = proposed(h.edges, h.weights, to);
        EXPECT_EQ(out.front(), h.edges.front());
        EXPECT_EQ(out.back(), h.edges.back());
        // Sums of n numbers that add up to 1, and the edge's own rounding, which in a narrow
        // interval of much weight counts for more: 1 of n at a length of at least 0.01 of at most
        // 64 n metres.
        for (int k = 1; k < to; ++k)
          ASSERT_NEAR(share_before(h.edges, h.weights, out[k]), double(k) / to,
                      (2 * n + 8) * kRoundoff + 2 * kRoundoff * out[k] * 1 / 0.01)
              << k << " of " << to;
      }
}

TEST(PdfEdges, JitterShiftsAllQuantilesByOneFraction) {
  constexpr int kRays = 50000, kTo = 5;
  const Histogram h(12, 3);
  double sum = 0, squares = 0;
  for (int ray = 0; ray < kRays; ++ray) {
    const std::vector<float> out = proposed(h.edges, h.weights, kTo, true, ray);
    ASSERT_EQ(out.front(), h.edges.front());
    ASSERT_EQ(out.back(), h.edges.back());
    const double shift = kTo * share_before(h.edges, h.weights, out[1]) - 1;
    ASSERT_NEAR(shift, 0, 0.5 + 1e-4);
    for (int k = 2; k < kTo; ++k)
      ASSERT_NEAR(kTo * share_before(h.edges, h.weights, out[k]) - k, shift, 1e-4);
    sum += shift;
    squares += shift * shift;
  }
  EXPECT_NEAR(sum / kRays, 0, 5 * std::sqrt(1.0 / 12 / kRays));
  EXPECT_NEAR(squares / kRays, 1.0 / 12, 5 * std::sqrt(1.0 / 180 / kRays));
}

TEST(PdfEdges, KeepTheIntervalsOfAnEmptyRay) {
  // The padding is the same for each interval: as many quantiles as intervals are the edges
  // themselves.
  const Histogram h(16, 5);
  const std::vector<float> out = proposed(h.edges, std::vector<float>(16, 0.0f), 16);
  for (int k = 0; k <= 16; ++k) EXPECT_NEAR(out[k], h.edges[k], 32 * 64 * 16 * kRoundoff) << k;
}

TEST(PdfEdges, DependOnRatiosOfWeightsOnly) {
  const Histogram h(24, 6);
  std::vector<float> faint = h.weights;
  for (float& w : faint) w *= 0x1p-60f;
  EXPECT_EQ(proposed(h.edges, faint, 13, true, 4), proposed(h.edges, h.weights, 13, true, 4));
}

TEST(PdfEdges, AscendForAnyWeights) {
  for (std::uint64_t seed = 0; seed < 2000; ++seed) {
    Histogram h(1 + seed % 40, seed);
    const float scale = seed % 3 == 0 ? 1 : seed % 3 == 1 ? 0x1p-140f : 1e30f;
    for (float& w : h.weights) w *= scale;
    const std::vector<float> out = proposed(h.edges, h.weights, 1 + seed % 33, true, seed);
    ASSERT_TRUE(std::is_sorted(out.begin(), out.end())) << seed;
    ASSERT_EQ(out.front(), h.edges.front());
    ASSERT_EQ(out.back(), h.edges.back());
    for (const float t : out) ASSERT_TRUE(std::isfinite(t)) << seed;
  }
}

const Contraction kRoad{{3, -1, 0.5f}, 8, true}, kRoom{{3, -1, 0.5f}, 8, false};

double coordinate(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(42, kStreamTest, stream), i) - 1;
}

constexpr RaySpacing kNearToFar{0.5f, 100, 20};

RaySpacing spacing_in_room(std::array<float, 3> origin, std::array<float, 3> direction) {
  return clip_to_scene(kNearToFar, kRoom, origin.data(), direction.data());
}

TEST(ClipToScene, KeepsTheSpacingOfAnUnboundedScene) {
  const float origin[3] = {50, 0, 0}, direction[3] = {1, 0, 0};
  const RaySpacing spacing = clip_to_scene(kNearToFar, kRoad, origin, direction);
  EXPECT_EQ(spacing.near_m, 0.5f);
  EXPECT_EQ(spacing.far_m, 100);
  EXPECT_EQ(spacing.half_m, 20);
}

TEST(ClipToScene, ClipsToTheCube) {
  // The room is [-5, 11] x [-9, 7] x [-7.5, 8.5].
  const auto expect = [](const RaySpacing& spacing, float enter, float leave) {
    EXPECT_FLOAT_EQ(spacing.near_m, enter);
    EXPECT_FLOAT_EQ(spacing.far_m, leave);
    EXPECT_TRUE(std::isinf(spacing.half_m)) << "uniform in distance";
  };
  expect(spacing_in_room({-25, 0, 0}, {1, 0, 0}), 20, 36);
  expect(spacing_in_room({3, -1, 40.5f}, {0, 0, -1}), 32, 48);
  expect(spacing_in_room({0, 0, 0}, {0, 1, 0}), 0.5f, 7);        // from within, from near_m on
  expect(spacing_in_room({-205, 0, 0}, {1, 0, 0}), 0.5f, 0.5f);  // beyond far_m
  expect(spacing_in_room({-95, 0, 0}, {1, 0, 0}), 90, 100);      // far_m ends it
  expect(spacing_in_room({-10, 0, 0}, {0.6f, 0.8f, 0}), 25.0f / 3,
         8.75f);                                            // in by x = -5, out by y = 7
  expect(spacing_in_room({3, -9, 0}, {1, 0, 0}), 0.5f, 8);  // along a face
}

TEST(ClipToScene, GivesNoLengthToARayThatMisses) {
  for (const RaySpacing& spacing :
       {spacing_in_room({-25, 0, 0}, {-1, 0, 0}), spacing_in_room({-25, 8, 0}, {1, 0, 0}),
        spacing_in_room({-10, 0, 0}, {0.3f, 0.95f, 0}), spacing_in_room({12, 0, 0}, {0, 0, 1})}) {
    EXPECT_EQ(spacing.near_m, 0.5f);
    EXPECT_EQ(spacing.far_m, 0.5f);
  }
}

TEST(ClipToScene, EndsOnTheCubeForAnyOrigin) {
  int hits = 0;
  for (int i = 0; i < 2000; ++i) {
    std::array<float, 3> origin, direction;
    double square = 0;
    for (int k = 0; k < 3; ++k) {
      origin[k] = static_cast<float>(30 * coordinate(21, 3 * i + k));
      direction[k] = static_cast<float>(coordinate(22, 3 * i + k));
      square += direction[k] * direction[k];
    }
    for (float& d : direction) d /= static_cast<float>(std::sqrt(square));
    const RaySpacing spacing = spacing_in_room(origin, direction);
    const auto norm_at = [&](double t) {  // 1 on the cube
      double m = 0;
      for (int k = 0; k < 3; ++k)
        m = std::max(m, std::abs(origin[k] + t * direction[k] - kRoom.center[k]) / kRoom.half_m);
      return m;
    };
    if (spacing.near_m == spacing.far_m) {
      for (int s = 0; s <= 400; ++s) ASSERT_GT(norm_at(0.5 + 0.25 * s), 1 - 1e-4);
      continue;
    }
    ++hits;
    EXPECT_NEAR(norm_at(spacing.far_m), 1, 1e-5);
    if (spacing.near_m > 0.5f) {
      EXPECT_NEAR(norm_at(spacing.near_m), 1, 1e-5);
    }
    EXPECT_LT(norm_at(0.5 * (spacing.near_m + spacing.far_m)), 1);
  }
  EXPECT_GT(hits, 100);
}

}  // namespace
}  // namespace redrive
