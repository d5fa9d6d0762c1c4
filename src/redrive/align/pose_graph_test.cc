// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/pose_graph.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr int kKnots = 60;
constexpr double kRadius_m = 50;

/// A circle that is driven once and a fifth, by an odometry that turns 0.6 % too far.
struct Circle {
  std::vector<Rigid3d> exact;
  std::vector<Knot> knots;
  double step_rad = 2 * std::numbers::pi * 1.2 / (kKnots - 1);

  Circle() {
    const double step_m = step_rad * kRadius_m;
    Rigid3d exact_step = Rigid3d::Identity(), step = Rigid3d::Identity();
    exact_step.linear() = so3_exp({0, 0, step_rad});
    exact_step.translation() = Eigen::Vector3d(step_m, 0, 0);
    step.linear() = so3_exp({0, 0, 1.006 * step_rad});
    step.translation() = exact_step.translation();
    Rigid3d at = Rigid3d::Identity(), odometry = at;
    for (int k = 0; k < kKnots; ++k) {
      exact.push_back(at);
      knots.push_back({odometry, k * step_m, Vector6d::Constant(1e-8)});
      at = at * exact_step;
      odometry = odometry * step;
    }
  }

  /// Knot `to` in the axes of `from`, as it is.
  LoopClosure closure(int from, int to) const {
    Vector6d sigma;
    sigma << 0.02, 0.02, 0.02, 5e-4, 5e-4, 5e-4;
    return {from, to, exact[from].inverse(Eigen::Isometry) * exact[to],
            sigma.cwiseAbs2().asDiagonal()};
  }

  /// RMS of positions and rotations after the best rigid motion of the whole.
  Eigen::Vector2d errors(const std::vector<Rigid3d>& poses) const {
    Matrix6d normal = Matrix6d::Zero();
    Vector6d right = Vector6d::Zero();
    Rigid3d moved = Rigid3d::Identity();
    std::vector<Vector6d> residuals(poses.size());
    for (int round = 0; round < 5; ++round) {
      normal.setZero(), right.setZero();
      for (std::size_t k = 0; k < poses.size(); ++k) {
        const Rigid3d pose = moved * poses[k],
                      difference = exact[k].inverse(Eigen::Isometry) * pose;
        residuals[k] << difference.translation(), so3_log(difference.linear());
        const Matrix6d g = by_motion(pose, Eigen::Vector3d::Zero());
        normal += g.transpose() * motion_weights().asDiagonal() * g;
        right += g.transpose() * motion_weights().asDiagonal() * residuals[k];
      }
      const Vector6d by = -normal.ldlt().solve(right);
      Rigid3d change = Rigid3d::Identity();
      change.linear() = so3_exp(by.tail<3>());
      change.translation() = by.head<3>();
      moved = change * moved;
    }
    Eigen::Vector2d squares = Eigen::Vector2d::Zero();
    for (const Vector6d& r : residuals)
      squares += Eigen::Vector2d(r.head<3>().squaredNorm(), r.tail<3>().squaredNorm());
    return (squares / static_cast<double>(poses.size())).cwiseSqrt();
  }
};

std::vector<Rigid3d> poses_of(const std::vector<Knot>& knots) {
  std::vector<Rigid3d> poses;
  for (const Knot& knot : knots) poses.push_back(knot.world_from_body);
  return poses;
}

TEST(PoseGraph, WithoutClosuresNothingChanges) {
  const Circle circle;
  const ClosedTrajectory closed = close_trajectory(circle.knots, {});
  for (int k = 0; k < kKnots; ++k)
    EXPECT_EQ(closed.poses[k].matrix(), circle.knots[k].world_from_body.matrix());
}

TEST(PoseGraph, ClosesACircleThatDrifts) {
  const Circle circle;
  const int turn = static_cast<int>(std::lround(2 * std::numbers::pi / circle.step_rad));
  std::vector<LoopClosure> closures;
  for (int k = 0; k + turn < kKnots; k += 3) closures.push_back(circle.closure(k, k + turn));
  const ClosedTrajectory closed = close_trajectory(circle.knots, closures);
  for (const bool accepted : closed.accepted) EXPECT_TRUE(accepted);
  const Eigen::Vector2d before = circle.errors(poses_of(circle.knots)),
                        after = circle.errors(closed.poses);
  EXPECT_GT(closed.before_m, 0.5);
  EXPECT_LT(closed.after_m, 0.02);
  EXPECT_GT(before.x(), 0.2);
  EXPECT_LT(after.x(), 0.05 * before.x());
  EXPECT_LT(after.y(), 0.1 * before.y());
  // The stated deviations bound the errors.
  double variance = 0;
  for (const Vector6d& of : closed.variance) variance += of.head<3>().sum() / kKnots;
  EXPECT_GT(std::sqrt(variance), after.x());
  EXPECT_LT(std::sqrt(variance), before.x());
}

TEST(PoseGraph, RejectsAFalseClosure) {
  const Circle circle;
  const int turn = static_cast<int>(std::lround(2 * std::numbers::pi / circle.step_rad));
  std::vector<LoopClosure> closures;
  for (int k = 0; k + turn < kKnots; k += 3) closures.push_back(circle.closure(k, k + turn));
  const ClosedTrajectory right = close_trajectory(circle.knots, closures);
  LoopClosure wrong = circle.closure(4, 4 + turn);
  wrong.from_to.translation().x() += 2;
  closures.insert(closures.begin() + 1, wrong);
  const ClosedTrajectory closed = close_trajectory(circle.knots, closures);
  for (std::size_t c = 0; c < closures.size(); ++c) EXPECT_EQ(closed.accepted[c], c != 1) << c;
  for (int k = 0; k < kKnots; ++k)
    EXPECT_LT((closed.poses[k].translation() - right.poses[k].translation()).norm(), 1e-4);
}

TEST(PoseGraph, RejectsAClosureThatNoDriftExplains) {
  const Circle circle;
  const int turn = static_cast<int>(std::lround(2 * std::numbers::pi / circle.step_rad));
  LoopClosure wrong = circle.closure(0, turn);
  wrong.from_to.translation().y() += 5 * drift_m(circle.knots[turn].way_m);
  const ClosedTrajectory closed = close_trajectory(circle.knots, {wrong});
  EXPECT_FALSE(closed.accepted[0]);
  for (int k = 0; k < kKnots; ++k)
    EXPECT_EQ(closed.poses[k].matrix(), circle.knots[k].world_from_body.matrix());
}

// A straight way with a closure between its ends, whose links drift alike: the correction is spread
// evenly; in a part that is stated worse, there.
TEST(PoseGraph, SpreadsTheCorrectionByTheVariances) {
  std::vector<Knot> knots;
  for (int k = 0; k <= 20; ++k) {
    Knot knot{Rigid3d(Eigen::Translation3d(10 * k, 0, 0)), 10.0 * k, Vector6d::Zero()};
    knots.push_back(knot);
  }
  LoopClosure closure{0, 20, knots.back().world_from_body, 1e-8 * Matrix6d::Identity()};
  closure.from_to.translation().x() += 0.4;
  const auto stretched = [&](int k) {
    const ClosedTrajectory closed = close_trajectory(knots, {closure});
    EXPECT_TRUE(closed.accepted[0]);
    return (closed.poses[k + 1].translation() - closed.poses[k].translation()).x() - 10;
  };
  for (const int k : {0, 7, 19}) EXPECT_NEAR(stretched(k), 0.02, 2e-4);
  // Knot 10 is known to 0.2 m: its two links have 0.004 + 0.04 m^2, the 18 others 0.004 m^2.
  knots[10].variance.setConstant(0.04);
  EXPECT_NEAR(stretched(10), 0.4 * 0.044 / (18 * 0.004 + 2 * 0.044), 2e-3);
  EXPECT_NEAR(stretched(3), 0.4 * 0.004 / (18 * 0.004 + 2 * 0.044), 2e-4);
}

}  // namespace
}  // namespace redrive
