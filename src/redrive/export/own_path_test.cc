// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/own_path.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

/// A drive of five frames, 0.1 s apart, along x on a road that rises to the left by a tenth.
class OwnPath : public ::testing::Test {
 protected:
  OwnPath() {
    for (std::size_t f = 0; f < recording_.frames.size(); ++f) {
      FramePose& frame = recording_.frames[f];
      frame.t_ns = 1'000'000'000 + static_cast<std::int64_t>(f) * 100'000'000;
      frame.global_from_body = Rigid3d(Eigen::AngleAxisd(std::atan(0.1), Eigen::Vector3d::UnitX()));
      frame.global_from_body.translation().x() = static_cast<double>(f);
    }
    scene_ = make_scene(recording_, {});
    // The world is level here, as recordings with a tilted first pose are not.
    scene_.global_from_world = Rigid3d::Identity();
  }
  std::vector<FramePose> poses(const std::string& csv) const {
    return poses_on_own_path(csv, "way.csv", scene_);
  }
  std::string error(const std::string& csv) const {
    try {
      poses(csv);
    } catch (const InputError& error) {
      return error.what();
    }
    return "none";
  }
  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path, 5);
  Scene scene_;
};

TEST_F(OwnPath, TurnsWithTheWayOnTheDrivenGround) {
  const auto on_way = poses("y_m, t_s, x_m\n0,0,0\n0,0.2,2\n5,0.7,2\n");
  ASSERT_EQ(on_way.size(), 5u);
  const Rigid3d& last = on_way[4].global_from_body;
  EXPECT_NEAR(last.translation().x(), 2, 1e-9);
  EXPECT_NEAR(last.translation().y(), 2, 1e-9) << "0.4 s";
  EXPECT_NEAR(last.translation().z(), 0.2, 1e-9) << "the road rises";
  EXPECT_NEAR(last.linear().determinant(), 1, 1e-9);
  EXPECT_NEAR(last.linear().col(2).y(), -0.1 / std::hypot(1, 0.1), 1e-9);
  EXPECT_GT(last.linear()(1, 0), 0.8) << "to the left";
}

TEST_F(OwnPath, ThatStandsKeepsTheHeading) {
  const auto standing = poses("t_s,x_m,y_m\n0,1,0\n9,1,0\n");
  for (const FramePose& pose : standing) EXPECT_GT(pose.global_from_body.linear()(0, 0), 0.99);
  EXPECT_EQ(poses("t_s,x_m,y_m\n0,1,0\n0.15,1,0\n").size(), 2u) << "the file ends";
}

TEST_F(OwnPath, NamesLineAndColumn) {
  EXPECT_THAT(error("t_s,x_m\n0,1\n1,2\n"), HasSubstr("must name the columns t_s, x_m and y_m"));
  EXPECT_THAT(error(""), HasSubstr("must name the columns"));
  EXPECT_THAT(error("t_s,x_m,y_m\n0,1,2\n1,2,nan\n"), AllOf(HasSubstr("line 3"), HasSubstr("y_m")));
  EXPECT_THAT(error("t_s,x_m,y_m\n0,1,2\n0,2,3\n"), HasSubstr("later than the line before"));
  EXPECT_THAT(error("t_s,x_m,y_m\n0.5,1,2\n1,2,3\n"), HasSubstr("must begin at 0"));
  EXPECT_THAT(error("t_s,x_m,y_m\n0,1,2\n1,2\n"), HasSubstr("line 3"));
}

}  // namespace
}  // namespace redrive
