// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/close_loops.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/align/lidar/made_block_testing.h"
#include "redrive/recording/core/register_trajectories.h"

namespace redrive {
namespace {

using testing::drifted;
using testing::drive_around;
using testing::MadeBlock;

AlignResult aligned(const std::vector<FramePose>& frames) {
  AlignResult result;
  result.frames = frames;
  result.corrections.resize(frames.size());
  for (Correction& correction : result.corrections)
    correction.sigma << 0.01, 0.01, 0.01, 3e-4, 3e-4, 3e-4;
  return result;
}

/// What the LiDAR of the true drive sees, placed by the poses of the drifted one.
PointsOfFrames points_of(const MadeBlock& block, const std::vector<FramePose>& exact,
                         const std::vector<FramePose>& frames) {
  return [&](const FrameWindow& window) {
    std::vector<Eigen::Vector3d> points;
    for (int f = window.begin; f < window.end; f += 5) {
      const Rigid3d moved =
          frames[f].global_from_body * exact[f].global_from_body.inverse(Eigen::Isometry);
      for (const Eigen::Vector3d& p : block.seen_from(exact[f].global_from_body.translation(), f))
        points.push_back(moved * p);
    }
    return points;
  };
}

TEST(LoopCandidates, AreWhereTheDrivePassesAgain) {
  EXPECT_TRUE(find_loop_candidates({}).empty());
  EXPECT_TRUE(find_loop_candidates(drive_around(0.8)).empty());
  const std::vector<FramePose> frames = drive_around(1.3);  // 327 m, 251 m of which once
  const std::vector<LoopCandidate> found = find_loop_candidates(frames);
  ASSERT_EQ(found.size(), 4u);
  for (const LoopCandidate& candidate : found) {
    EXPECT_NEAR(candidate.way_m, 256, 14);
    EXPECT_LT(candidate.distance_m, 12);
  }
  // A car that waits has not passed again.
  std::vector<FramePose> waits(50, frames.front());
  EXPECT_TRUE(find_loop_candidates(waits).empty());
}

TEST(CloseLoops, OfADriveAroundABlock) {
  const MadeBlock block;
  const std::vector<FramePose> exact = drive_around(1.25), frames = drifted(exact, 5e-5);
  Recording recording;
  recording.frames = frames;
  AlignResult result = aligned(frames);
  const LoopClosures report = close_loops(recording, points_of(block, exact, frames), &result);
  EXPECT_GE(report.candidates, 3);
  EXPECT_EQ(report.accepted, report.candidates) << ::testing::PrintToString(report.doubts);
  EXPECT_GT(report.before_m, 0.3);
  EXPECT_LT(report.after_m, 0.05);
  const double before = register_trajectories(frames, exact, "").residual_m,
               after = register_trajectories(result.frames, exact, "").residual_m;
  EXPECT_GT(before, 0.05);
  EXPECT_LT(after, 0.5 * before);
  // The passes agree.
  const LoopCandidate last = find_loop_candidates(exact).back();
  const auto between = [&](const std::vector<FramePose>& of) -> Rigid3d {
    return of[last.from].global_from_body.inverse(Eigen::Isometry) * of[last.to].global_from_body;
  };
  EXPECT_LT((between(result.frames).translation() - between(exact).translation()).norm(), 0.05);
  // No step between two frames, and corrections apply to the recording's poses.
  for (std::size_t f = 1; f < frames.size(); ++f) {
    const Rigid3d step = result.frames[f - 1].global_from_body.inverse(Eigen::Isometry) *
                         result.frames[f].global_from_body,
                  was = frames[f - 1].global_from_body.inverse(Eigen::Isometry) *
                        frames[f].global_from_body;
    EXPECT_LT((step.translation() - was.translation()).norm(), 0.02) << f;
    EXPECT_LT((frames[f].global_from_body * result.corrections[f].value.head<3>() -
               result.frames[f].global_from_body.translation())
                  .norm(),
              1e-9);
    EXPECT_GE(result.corrections[f].sigma[0], 0.01);
    EXPECT_LT(result.corrections[f].sigma.head<3>().norm(), 0.5);
  }
}

TEST(CloseLoops, OfADriveThatNeverMeetsItselfChangesNothing) {
  const std::vector<FramePose> frames = drive_around(0.7);
  Recording recording;
  recording.frames = frames;
  AlignResult result = aligned(frames);
  const LoopClosures report = close_loops(
      recording,
      [](const FrameWindow&) -> std::vector<Eigen::Vector3d> {
        ADD_FAILURE() << "no points are needed";
        return {};
      },
      &result);
  EXPECT_EQ(report.candidates, 0);
  for (std::size_t f = 0; f < frames.size(); ++f)
    EXPECT_EQ(result.frames[f].global_from_body.matrix(), frames[f].global_from_body.matrix());
}

// The second pass is seen among other houses: nothing fits, and nothing changes.
TEST(CloseLoops, OfAnotherPlaceChangesNothing) {
  const MadeBlock block;
  const std::vector<FramePose> exact = drive_around(1.25);
  Recording recording;
  recording.frames = exact;
  AlignResult result = aligned(exact);
  const LoopClosures report = close_loops(
      recording,
      [&](const FrameWindow& window) {
        if (window.begin < 200) return points_of(block, exact, exact)(window);
        // Houses of another part of the block.
        std::vector<FramePose> elsewhere = exact;
        for (FramePose& frame : elsewhere)
          frame.global_from_body = so3_exp({0, 0, 1.7}) * frame.global_from_body;
        return points_of(block, elsewhere, exact)(window);
      },
      &result);
  EXPECT_GE(report.candidates, 3);
  EXPECT_EQ(report.accepted, 0);
  for (std::size_t f = 0; f < exact.size(); ++f)
    EXPECT_EQ(result.frames[f].global_from_body.matrix(), exact[f].global_from_body.matrix());
}

}  // namespace
}  // namespace redrive
