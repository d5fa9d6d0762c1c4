// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/moving_object.h"

#include <gtest/gtest.h>

#include "redrive/math/so3.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

/// Keys 100 ns apart, turned and 2 m apart, each corrected forward by 1 cm more than the one before
/// from 3 cm on.
MovingObject corrected_object() {
  MovingObject object;
  for (int i = 0; i < 4; ++i) {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = so3_exp(Vector3d(0.1, 0.2 * i, -0.1 * i));
    pose.translation() = Vector3d(2 * i, 1, -3);
    object.keys.push_back({100 * i, pose, Vector3d::Zero()});
    object.corrections.insert(object.corrections.end(), {0.03f + 0.01f * i, 0, 0, 0, 0, 0});
  }
  return object;
}

TEST(MovingObject, CorrectionsAreLinearBetweenKeysAndConstantBeyond) {
  const MovingObject object = corrected_object();
  for (const auto& [t_ns, forward_m] :
       {std::pair(125, 0.0425), std::pair(200, 0.05), std::pair(-5, 0.03), std::pair(900, 0.06)}) {
    const auto pose = object.world_from_box(t_ns),
               recorded = object.world_from_box(t_ns, Poses::kRecorded);
    ASSERT_TRUE(pose && recorded);
    const Rigid3d motion = recorded->inverse() * *pose;
    EXPECT_LT((motion.translation() - Vector3d(forward_m, 0, 0)).norm(), 1e-8) << t_ns;
    EXPECT_LT((motion.linear() - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  }
}

TEST(MovingObject, CorrectionsMoveIntoTheKeys) {
  MovingObject object = corrected_object();
  object.corrections[6 * 2 + 4] = 0.05f;  // turns the third key
  const MovingObject before = object;
  object.apply_corrections();
  EXPECT_TRUE(object.corrections.empty());
  for (const MovingObject::Key& key : object.keys)
    EXPECT_LT((before.world_from_box(key.t_ns)->matrix() - key.world_from_box.matrix()).norm(),
              1e-12);
}

}  // namespace
}  // namespace redrive
