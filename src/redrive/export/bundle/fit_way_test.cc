// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/fit_way.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

using Eigen::Vector2d;

/// Points every `step_m` along pieces, moved at random by up to `noise_m` along each axis.
std::vector<Vector2d> points_on(const std::vector<PlanPiece>& pieces, double step_m,
                                double noise_m = 0) {
  std::vector<Vector2d> points;
  for (const PlanPiece& piece : pieces)
    for (double s = 0; s < piece.length_m; s += step_m) {
      const auto noise = [&](std::uint64_t k) {
        return noise_m * (2.0 * random_unit(1, 2 * points.size() + k) - 1);
      };
      points.emplace_back(piece.at(s).position() + Vector2d(noise(0), noise(1)));
    }
  return points;
}

/// Pieces one after another from the origin along x: length, curvature at both ends.
std::vector<PlanPiece> chain(const std::vector<std::array<double, 3>>& shapes) {
  std::vector<PlanPiece> pieces;
  PlanPose at{3, -2, 0.7};
  for (const auto& [length, from, to] : shapes) {
    pieces.push_back({at, length, from, (to - from) / length});
    at = pieces.back().at(length);
  }
  return pieces;
}

double farthest(const std::vector<PlanPiece>& pieces, const std::vector<Vector2d>& points) {
  double most = 0;
  for (const Vector2d& point : points) {
    double nearest = 1e9;
    for (const PlanPiece& piece : pieces)
      nearest = std::min(nearest, foot_on(piece, point).distance_m);
    most = std::max(most, nearest);
  }
  return most;
}

double largest_break(const std::vector<PlanPiece>& pieces) {
  double most = 0;
  for (std::size_t i = 1; i < pieces.size(); ++i) {
    const PlanPose end = pieces[i - 1].at(pieces[i - 1].length_m);
    most = std::max({most, (end.position() - pieces[i].start.position()).norm(),
                     std::abs(end.heading_rad - pieces[i].start.heading_rad)});
  }
  return most;
}

TEST(FitWay, PiecesAreTheirFormulas) {
  const PlanPiece arc{{1, 2, 0}, 10, 0.1, 0};  // radius 10, centre (1, 12)
  const PlanPose quarter = arc.at(5 * std::numbers::pi);
  EXPECT_NEAR(quarter.x, 11, 1e-9);
  EXPECT_NEAR(quarter.y, 12, 1e-9);
  EXPECT_NEAR(quarter.heading_rad, std::numbers::pi / 2, 1e-12);
  // A clothoid from a line: x = s - s^5 / (40 a^4), y = s^3 / (6 a^2) - s^7 / (336 a^6), a^2 = 1 /
  // rate (Fresnel's series).
  const PlanPiece clothoid{{}, 20, 0, 1.0 / 400};
  EXPECT_NEAR(clothoid.at(8).x, 8 - 32768.0 / 40 / 160000 + 134217728.0 / 3456 / 2.56e10, 1e-8);
  EXPECT_NEAR(clothoid.at(8).y, 512.0 / 6 / 400 - 2097152.0 / 336 / 6.4e7, 1e-7);
  const Foot foot = foot_on(arc, {1, 12 - 9.5});
  EXPECT_NEAR(foot.distance_m, 0.5, 1e-9);
  EXPECT_NEAR(foot.along_m, 0, 1e-5);
}

TEST(FitWay, ClothoidsEndWhereTheyShould) {
  for (const double to_y : {-6.0, 0.0, 0.001, 9.0})
    for (const double heading : {-0.9, 0.0, 0.9}) {
      const PlanPose from{5, 1, 0.3}, to{25, 1 + to_y, 0.3 + heading};
      const PlanPiece piece = clothoid_between(from, to);
      ASSERT_GT(piece.length_m, 0);
      const PlanPose end = piece.at(piece.length_m);
      EXPECT_NEAR(end.x, to.x, 1e-8);
      EXPECT_NEAR(end.y, to.y, 1e-8);
      EXPECT_NEAR(std::remainder(end.heading_rad - to.heading_rad, 2 * std::numbers::pi), 0, 1e-9);
    }
  EXPECT_EQ(clothoid_between({0, 0, 0}, {-5, 0, 0}).length_m, 0) << "behind";
}

TEST(FitWay, FindsLinesAndArcs) {
  const std::vector<PlanPiece> straight = fit_way(points_on(chain({{{150, 0, 0}}}), 0.8));
  ASSERT_EQ(straight.size(), 1u);
  EXPECT_EQ(straight[0].curvature_per_m, 0);
  EXPECT_EQ(straight[0].curvature_rate_per_m2, 0);
  EXPECT_NEAR(straight[0].length_m, 149.6, 0.01);
  const std::vector<PlanPiece> arc = fit_way(points_on(chain({{{50, 0.02, 0.02}}}), 0.8));
  ASSERT_EQ(arc.size(), 1u);
  EXPECT_NEAR(arc[0].curvature_per_m, 0.02, 1e-5);
  EXPECT_EQ(arc[0].curvature_rate_per_m2, 0);
}

TEST(FitWay, FollowsCurvesWithinFiveCentimetres) {
  const std::vector<std::vector<PlanPiece>> ways = {
      chain({{60, 0, 0.05}}),  // a clothoid
      chain({{30, 0, 0}, {20, 0, 0.04}, {30, 0.04, 0.04}, {20, 0.04, 0}, {40, 0, 0}}),
      chain({{25, 0, 0.06}, {50, 0.06, -0.06}, {25, -0.06, 0}}),  // an S
      chain({{10, 0, 0}, {12, 0.12, 0.12}, {10, 0, 0}}),          // a corner, 8 m radius
      chain({{300, 0.03, 0.03}}),                                 // a loop and a half
  };
  for (const auto& way : ways)
    for (const double noise_m : {0.0, 0.02}) {
      const std::vector<Vector2d> points = points_on(way, 0.3, noise_m);
      const std::vector<PlanPiece> pieces = fit_way(points);
      ASSERT_FALSE(pieces.empty());
      EXPECT_LE(farthest(pieces, points), 0.05) << way.size() << " pieces, noise " << noise_m;
      EXPECT_LE(largest_break(pieces), 1e-9);
      if (noise_m == 0) {
        EXPECT_LE(pieces.size(), 3 * way.size() + 3);
      }
    }
}

TEST(FitWay, TakesAnyPoints) {
  EXPECT_TRUE(fit_way({}).empty());
  EXPECT_TRUE(fit_way(std::vector<Vector2d>(5, {1, 1})).empty());
  EXPECT_EQ(fit_way(std::vector<Vector2d>{{0, 0}, {1, 0}}).size(), 1u);
  // Back and forth: jumps are followed, too.
  const std::vector<Vector2d> jumps = {{0, 0}, {5, 0}, {0, 1}, {5, 2}, {-3, 2}};
  EXPECT_LE(farthest(fit_way(jumps), jumps), 0.05);
}

}  // namespace
}  // namespace redrive
