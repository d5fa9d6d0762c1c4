// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/far_photographs.h"

#include <cmath>

#include <gtest/gtest.h>

namespace redrive {
namespace {

/// Photographs on a circle of radius 2, but for those at `far`.
Recording circle(int photographs, const std::vector<std::pair<int, Eigen::Vector3d>>& far) {
  Recording recording;
  recording.metric = false;
  recording.cameras.resize(1);
  for (int i = 0; i < photographs; ++i) {
    FramePose frame{i, i, Rigid3d::Identity()};
    frame.global_from_body.translation() = Eigen::Vector3d(2 * std::cos(i), 2 * std::sin(i), 5);
    for (const auto& [which, position] : far)
      if (which == i) frame.global_from_body.translation() = position;
    recording.frames.push_back(frame);
    recording.cameras[0].images.push_back({{i, std::to_string(i) + ".jpg"}, {}, false});
  }
  leave_out_far_photographs(&recording);
  return recording;
}

TEST(FarPhotographs, AreLeftOut) {
  const Recording recording = circle(40, {{7, {900, 0, 0}}});
  EXPECT_EQ(recording.frames.size(), 39u);
  EXPECT_EQ(recording.cameras[0].images.size(), 39u);
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_EQ(recording.findings[0].what,
            "1 photograph left out, more than 20 times as far from the middle as half of all are: "
            "7.jpg");
}

TEST(FarPhotographs, OverviewsAndSmallSetsAreKept) {
  EXPECT_EQ(circle(40, {{7, {30, 0, 0}}}).frames.size(), 40u);
  EXPECT_EQ(circle(40, {{7, {90, 0, 0}}, {8, {92, 0, 0}}}).frames.size(), 40u) << "two together";
  EXPECT_EQ(circle(10, {{7, {900, 0, 0}}}).frames.size(), 10u);
  EXPECT_EQ(circle(0, {}).frames.size(), 0u);
}

}  // namespace
}  // namespace redrive
