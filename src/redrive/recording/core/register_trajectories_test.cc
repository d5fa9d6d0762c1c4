// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/register_trajectories.h"

#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

/// A straight drive of 5 m along x at ECEF magnitudes.
std::vector<FramePose> straight_drive() {
  std::vector<FramePose> frames;
  for (int i = 0; i < 6; ++i) {
    FramePose frame;
    frame.id = 100 + i;
    frame.global_from_body = Eigen::Translation3d(4.1e6 + i, 1.4e6, 4.7e6);
    frames.push_back(frame);
  }
  return frames;
}

// Also finds the rotation about the straight line, which positions alone leave unobservable.
TEST(RegisterTrajectories, FindsARigidMotion) {
  const std::vector<FramePose> ground_truth = straight_drive();
  const Eigen::Vector3d middle(4.1e6 + 2.5, 1.4e6, 4.7e6), shift(0.3, 0, -0.4);
  const Eigen::AngleAxisd turn(0.01, Eigen::Vector3d::UnitX());
  const Rigid3d motion =
      Eigen::Translation3d(middle + shift) * turn * Eigen::Translation3d(-middle);
  std::vector<FramePose> run = ground_truth;
  for (FramePose& frame : run) frame.global_from_body = motion * frame.global_from_body;
  const TrajectoryRegistration alignment =
      register_trajectories(run, ground_truth, "ground_truth.json");
  EXPECT_EQ(alignment.frames, 6);
  EXPECT_NEAR(alignment.translation_m, 0.5, 1e-8);
  EXPECT_NEAR(alignment.rotation_deg, 0.01 * 180 / std::numbers::pi, 1e-8);
  EXPECT_LT(alignment.residual_m, 1e-8);
  EXPECT_LT(alignment.residual_deg, 1e-6);
  for (std::size_t i = 0; i < run.size(); ++i) {
    const Rigid3d there = alignment.run_from_ground_truth * ground_truth[i].global_from_body;
    EXPECT_LT((there.translation() - run[i].global_from_body.translation()).norm(), 1e-8);
    EXPECT_LT((there.linear() - run[i].global_from_body.linear()).norm(), 1e-8);
  }
}

// Errors of alternating sign are no rigid motion and remain as residuals.
TEST(RegisterTrajectories, ReportsResidualsOfNonRigidErrors) {
  const std::vector<FramePose> ground_truth = straight_drive();
  std::vector<FramePose> run = ground_truth;
  for (std::size_t i = 0; i < run.size(); ++i) {
    const double side = i == 0 || i == 3 || i == 4 ? 1 : -1;  // sum and moment are 0: no yaw either
    run[i].global_from_body = Eigen::Translation3d(0, 0.06 * side, 0) * run[i].global_from_body;
  }
  const TrajectoryRegistration alignment =
      register_trajectories(run, ground_truth, "ground_truth.json");
  EXPECT_NEAR(alignment.residual_m, 0.06, 0.002);
  EXPECT_LT(alignment.translation_m, 0.01);
}

TEST(RegisterTrajectories, PairsFramesById) {
  std::vector<FramePose> ground_truth = straight_drive();
  const std::vector<FramePose> run(ground_truth.begin() + 2, ground_truth.begin() + 4);
  EXPECT_EQ(register_trajectories(run, ground_truth, "ground_truth.json").frames, 2);
  for (FramePose& frame : ground_truth) frame.id += 1000;
  EXPECT_THROW(register_trajectories(run, ground_truth, "ground_truth.json"), InputError);
}

}  // namespace
}  // namespace redrive
