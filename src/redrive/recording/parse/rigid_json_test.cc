// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/rigid_json.h"

#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

TEST(RigidFromJson, ReadsRowMajorAndRestoresTheNearestRotation) {
  const nlohmann::json json = {
      {0, -1.0003, 0, 4e6}, {0.9998, 0, 0, 20}, {0, 0, 1, 30}, {0, 0, 0, 1}};
  const Rigid3d transform = rigid_from_json(JsonField(json, "pose.json"));
  EXPECT_EQ(transform.translation(), Eigen::Vector3d(4e6, 20, 30));
  const Eigen::Matrix3d r = transform.linear();
  EXPECT_LT((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff(), 1e-14);
  EXPECT_LT((r - Eigen::Matrix3d(Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitZ())))
                .cwiseAbs()
                .maxCoeff(),
            1e-14);
}

TEST(RigidFromJson, NamesFileFieldAndRule) {
  const nlohmann::json json = {{"pose", {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, -1, 0}, {0, 0, 0, 1}}}};
  try {
    rigid_from_json(JsonField(json, "pose.json").at("pose"));
    FAIL() << "a reflection was accepted";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(),
                ::testing::AllOf(HasSubstr("pose.json: pose = [["), HasSubstr("det = -1")));
  }
}

TEST(RigidToJson, RoundTrip) {
  const Rigid3d transform =
      Eigen::Translation3d(1, 2, 3) * Rigid3d(Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitX()));
  const nlohmann::json json = rigid_to_json(transform);
  EXPECT_TRUE(rigid_from_json(JsonField(json, "pose.json")).isApprox(transform, 1e-15));
}

}  // namespace
}  // namespace redrive
