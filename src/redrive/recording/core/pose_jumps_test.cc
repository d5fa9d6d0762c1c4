// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/pose_jumps.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/math/so3.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

/// Drives a curve at 8 m/s that brakes to 5 m/s, at 10 Hz; with a noise of `noise_m` in turns.
std::vector<FramePose> curve(int frames, double noise_m = 0) {
  std::vector<FramePose> all;
  double x = 0, y = 0, yaw = 0;
  for (int f = 0; f < frames; ++f) {
    FramePose frame{1000 + f, f * 100'000'000ll, Rigid3d::Identity()};
    frame.global_from_body.linear() = so3_exp({0, 0, yaw});
    frame.global_from_body.translation() =
        Eigen::Vector3d(4e6 + x, y + (f % 2 ? noise_m : -noise_m), 7);
    all.push_back(frame);
    const double speed = f < frames / 2 ? 8 : std::max(5.0, 8 - 0.6 * (f - frames / 2));
    x += 0.1 * speed * std::cos(yaw);
    y += 0.1 * speed * std::sin(yaw);
    yaw += 0.03;
  }
  return all;
}

void displace(std::vector<FramePose>* frames, std::size_t begin, std::size_t end,
              const Eigen::Vector3d& by) {
  for (std::size_t f = begin; f < end; ++f) (*frames)[f].global_from_body.translation() += by;
}

TEST(PoseFaults, DrivingIsNone) {
  EXPECT_TRUE(find_pose_faults(curve(40)).empty());
  EXPECT_TRUE(find_pose_faults(curve(40, 0.1)).empty()) << "noise of all poses";
  EXPECT_TRUE(find_pose_faults(curve(4)).empty());
  EXPECT_TRUE(find_pose_faults({}).empty());
}

TEST(PoseFaults, NamesStrayPosesWhereverTheyLie) {
  for (const std::size_t at : {0u, 1u, 2u, 20u, 37u, 38u, 39u}) {
    std::vector<FramePose> frames = curve(40);
    displace(&frames, at, at + 1, {0, 3, 0});
    const PoseFaults faults = find_pose_faults(frames);
    ASSERT_EQ(faults.stray.size(), 1u) << at;
    EXPECT_EQ(faults.stray[0].frame, at);
    EXPECT_NEAR(faults.stray[0].off_m, 3, 0.2) << at;
    EXPECT_TRUE(faults.jumps.empty()) << at;
    const auto mended = without_stray_poses(frames, faults);
    EXPECT_LT(
        (mended[at].global_from_body.translation() - curve(40)[at].global_from_body.translation())
            .norm(),
        0.1)
        << at;
    const auto findings = describe_pose_faults(frames, faults);
    ASSERT_EQ(findings.size(), 1u);
    EXPECT_THAT(findings[0].what, HasSubstr("frame " + std::to_string(1000 + at) + " lies "));
  }
}

TEST(PoseFaults, NamesStrayRuns) {
  std::vector<FramePose> frames = curve(40);
  displace(&frames, 10, 13, {1, -2, 0});
  displace(&frames, 25, 26, {0, 0, 0.6});
  frames[30].global_from_body.linear() *= so3_exp({0, 0, 0.2});
  const PoseFaults faults = find_pose_faults(frames);
  std::vector<std::size_t> stray;
  for (const StrayPose& pose : faults.stray) stray.push_back(pose.frame);
  EXPECT_THAT(stray, ::testing::ElementsAre(10, 11, 12, 25, 30));
  EXPECT_NEAR(faults.stray.back().off_rad, 0.2, 0.01);
  EXPECT_TRUE(faults.jumps.empty());
}

TEST(PoseFaults, NamesJumps) {
  std::vector<FramePose> frames = curve(40);
  displace(&frames, 20, 40, {0, 3, 0});
  const PoseFaults faults = find_pose_faults(frames);
  EXPECT_TRUE(faults.stray.empty());
  ASSERT_EQ(faults.jumps.size(), 1u);
  EXPECT_EQ(faults.jumps[0].frame, 19u);
  EXPECT_NEAR(faults.jumps[0].shift_m, 3, 0.2);
  const auto findings = describe_pose_faults(frames, faults);
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_THAT(findings[0].what, HasSubstr("between frames 1019 and 1020 the poses jump by 3."));
}

TEST(PoseFaults, ManyFindingsAreCounted) {
  std::vector<FramePose> frames = curve(80);
  for (std::size_t f = 5; f < 75; f += 9) displace(&frames, f, f + 1, {0, 2, 0});
  const auto findings = describe_pose_faults(frames, find_pose_faults(frames));
  ASSERT_EQ(findings.size(), 6u);
  EXPECT_EQ(findings[5].what, "3 more poses off the motion of the frames around them");
}

}  // namespace
}  // namespace redrive
