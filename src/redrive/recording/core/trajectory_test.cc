// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/trajectory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;

constexpr double kTurn_rad = 0.3, kRadius_m = 6.4e6;

FramePose turning(std::int64_t t_ns, double turns) {
  FramePose frame;
  frame.t_ns = t_ns;
  frame.global_from_body = Eigen::Translation3d(kRadius_m + 2 * turns, 5, 7) *
                           Eigen::AngleAxisd(turns * kTurn_rad, Eigen::Vector3d(1, 2, 2) / 3);
  return frame;
}

// Constant speed and yaw rate, also beyond both ends.
TEST(Trajectory, FollowsConstantMotion) {
  const std::vector<FramePose> frames = {turning(1000, 0), turning(1100, 1), turning(1300, 3)};
  for (const double turns : {-0.5, 0.0, 0.25, 1.0, 1.5, 2.9, 3.0, 3.4}) {
    const Rigid3d pose = pose_at(frames, 1000 + static_cast<std::int64_t>(100 * turns));
    const Rigid3d expected = turning(0, turns).global_from_body;
    // 1e-9: a step of a double at 6.4e6.
    EXPECT_LT((pose.translation() - expected.translation()).norm(), 4e-9) << turns;
    EXPECT_LT((pose.linear() - expected.linear()).norm(), 1e-14) << turns;
  }
}

TEST(Trajectory, ReturnsAFramesPoseExactly) {
  const std::vector<FramePose> frames = {turning(1000, 0.123), turning(1100, 1.7)};
  for (const FramePose& frame : frames)
    EXPECT_EQ(pose_at(frames, frame.t_ns).matrix(), frame.global_from_body.matrix());
}

TEST(Trajectory, IsConstantForASingleFrame) {
  const std::vector<FramePose> frames = {turning(1000, 0.5)};
  for (const std::int64_t t_ns : {0, 1000, 5000})
    EXPECT_EQ(pose_at(frames, t_ns).matrix(), frames[0].global_from_body.matrix());
}

TEST(CheckTrajectory, NamesFileFrameAndField) {
  std::vector<FramePose> frames = {turning(0, 0), turning(1'000'000'000, 1)};
  frames[1].id = 7;
  const auto message = [&] {
    return testing::input_error([&] { check_trajectory(frames, "poses.csv", {"t", "T_wb"}); });
  };
  EXPECT_NO_THROW(check_trajectory(frames, "poses.csv", {"t", "T_wb"}));
  frames[1].global_from_body.translation().y() += 151;
  EXPECT_THAT(message(), AllOf(HasSubstr("poses.csv"), HasSubstr("7.T_wb"), HasSubstr("frame 0")));
  frames[1].t_ns = 0;
  EXPECT_THAT(message(), AllOf(HasSubstr("7.t"), HasSubstr("have to increase")));
}

}  // namespace
}  // namespace redrive
