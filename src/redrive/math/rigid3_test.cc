// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/rigid3.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

Eigen::Matrix4d quarter_turn() {
  Eigen::Matrix4d m;
  m << 0, -1, 0, 10, 1, 0, 0, 20, 0, 0, 1, 30, 0, 0, 0, 1;
  return m;
}

TEST(RigidObstacle, AcceptsARotationAndSaysWhatIsWrongWithOthers) {
  EXPECT_EQ(rigid_obstacle(quarter_turn()), "");
  Eigen::Matrix4d m = quarter_turn();
  m.row(2).head<3>() *= -1;
  EXPECT_THAT(rigid_obstacle(m), HasSubstr("det = -1, a reflection"));
  m = quarter_turn();
  m.topLeftCorner<3, 3>() *= 1.01;  // R R^T = 1.0201 I
  EXPECT_THAT(rigid_obstacle(m), HasSubstr("not orthonormal by 0.0201"));
  m = quarter_turn();
  m(3, 0) = 0.5;
  EXPECT_THAT(rigid_obstacle(m), HasSubstr("last row"));
  m = quarter_turn();
  m(0, 0) = NAN;
  EXPECT_EQ(rigid_obstacle(m), "not finite");
  EXPECT_NE(rigid_obstacle(Eigen::Matrix4d::Zero()), "");
}

TEST(RigidFromJson, ReadsRowMajorAndRestoresTheNearestRotation) {
  const nlohmann::json json = {{0, -1.0003, 0, 4e6}, {0.9998, 0, 0, 20}, {0, 0, 1, 30}, {0, 0, 0, 1}};
  const Rigid3d transform = rigid_from_json(JsonField(json, "pose.json"));
  EXPECT_EQ(transform.translation(), Eigen::Vector3d(4e6, 20, 30));
  const Eigen::Matrix3d r = transform.linear();
  EXPECT_LT((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff(), 1e-14);
  EXPECT_LT((r - quarter_turn().topLeftCorner<3, 3>()).cwiseAbs().maxCoeff(), 1e-14);
}

TEST(RigidFromJson, NamesFileFieldAndRule) {
  const nlohmann::json json = {{"pose", {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, -1, 0}, {0, 0, 0, 1}}}};
  try {
    rigid_from_json(JsonField(json, "pose.json").at("pose"));
    FAIL() << "a reflection was accepted";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), testing::AllOf(HasSubstr("pose.json: pose = [["), HasSubstr("det = -1")));
  }
}

}  // namespace
}  // namespace redrive
