// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/summary.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

FramePose frame(std::int64_t id, double x, std::int64_t t_ms) {
  FramePose pose{id, t_ms * 1000000, Rigid3d::Identity()};
  pose.global_from_body.translation().x() = x;
  return pose;
}

TEST(DriveSummary, SumsPathAndDuration) {
  const DriveSummary summary =
      summarize_drive({frame(1, 0, 0), frame(2, 2, 100), frame(3, 5, 200), frame(4, 4, 300)});
  EXPECT_DOUBLE_EQ(summary.duration_s, 0.3);
  EXPECT_DOUBLE_EQ(summary.rate_hz, 10);
  EXPECT_DOUBLE_EQ(summary.path_length_m, 6);
  EXPECT_DOUBLE_EQ(summary.mean_speed_m_per_s, 20);
  EXPECT_DOUBLE_EQ(summary.max_speed_m_per_s, 30);
  EXPECT_TRUE(summary.findings.empty());
}

TEST(DriveSummary, ReportsGapsInTime) {
  const DriveSummary summary = summarize_drive(
      {frame(1, 0, 0), frame(2, 1, 100), frame(5, 4, 400), frame(6, 5, 500), frame(7, 6, 600)});
  EXPECT_DOUBLE_EQ(summary.rate_hz, 10);
  ASSERT_EQ(summary.findings.size(), 1u);
  EXPECT_THAT(summary.findings[0].what,
              ::testing::AllOf(::testing::HasSubstr("0.300 s"), ::testing::HasSubstr("2 and 5")));
}

TEST(DriveSummary, ReportsPosesOffTheWay) {
  std::vector<FramePose> frames;
  for (int f = 0; f < 12; ++f) frames.push_back(frame(f, f + (f == 6 ? 3 : 0), 100 * f));
  const DriveSummary summary = summarize_drive(frames);
  ASSERT_EQ(summary.findings.size(), 1u);
  EXPECT_THAT(summary.findings[0].what, ::testing::HasSubstr("frame 6 lies 3.00 m"));
}

TEST(DriveSummary, IsZeroForOneFrame) {
  const DriveSummary summary = summarize_drive({frame(1, 0, 0)});
  EXPECT_EQ(summary.rate_hz, 0);
  EXPECT_EQ(summary.findings.size(), 1u);
}

}  // namespace
}  // namespace redrive
