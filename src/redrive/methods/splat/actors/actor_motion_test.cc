// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/actors/actor_motion.h"

#include <limits>

#include <gtest/gtest.h>

#include "redrive/math/so3.h"

namespace redrive {
namespace {

MovingObject object_with_keys() {
  MovingObject object;
  for (int i = 0; i < 4; ++i) {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = so3_exp(Eigen::Vector3d(0.1, 0.2 * i, -0.1 * i));
    pose.translation() = Eigen::Vector3d(2 * i, 1, -3);
    object.keys.push_back({100 * i, pose, {0, 0, 0}});
  }
  return object;
}

/// f(camera in the object's axes) = a . position + b . log(rotation of a disturbance).
TEST(ActorMotion, GradientAgreesWithDifferences) {
  const Rigid3d world_from_actor = object_with_keys().keys[2].world_from_box;
  Rigid3d world_from_camera = Rigid3d::Identity();
  world_from_camera.linear() = so3_exp(Eigen::Vector3d(-0.3, 0.5, 1));
  world_from_camera.translation() = Eigen::Vector3d(5, -4, 2);
  const Eigen::Vector3d a(0.7, -1.2, 0.4), b(-0.5, 0.3, 2);
  using Motion = std::array<float, kMotionSize>;
  const Motion start_motion = {0.3f, -0.2f, 0.1f, 0.02f, -0.03f, 0.05f};
  const auto camera_at = [&](const Motion& motion) {
    return (world_from_actor * rigid_from_vector(motion.data())).inverse() * world_from_camera;
  };
  const Rigid3d start = camera_at(start_motion);
  std::vector<float> motions(3 * kMotionSize);
  for (std::size_t k = 0; k < kMotionSize; ++k)
    motions[kMotionSize + k] = motions[2 * kMotionSize + k] = start_motion[k];
  const auto value = [&](const Motion& motion) {
    const Rigid3d now = camera_at(motion);
    return a.dot(now.translation()) + b.dot(so3_log(now.linear() * start.linear().transpose()));
  };
  GaussianPoseGradient<NumberMath<double>> d_pose;
  for (int k = 0; k < 3; ++k) {
    d_pose.translation[k] = a[k];
    d_pose.rotation[k] = b[k];
  }
  std::vector<float> gradient(3 * kMotionSize);
  add_motion_gradient(d_pose, start.translation(), motions, {1, 2, 0.25}, gradient);
  for (std::size_t k = 0; k < kMotionSize; ++k) {
    Motion above = start_motion, below = start_motion;
    above[k] += 1e-3f;
    below[k] -= 1e-3f;
    const double difference = (value(above) - value(below)) / 2e-3;
    EXPECT_EQ(gradient[k], 0);
    const double tolerance = k < 3 ? 5e-4 : 0.3;  // first order in w, of derivatives up to 5
    EXPECT_NEAR(gradient[kMotionSize + k], 0.75 * difference, tolerance) << k;
    EXPECT_NEAR(gradient[2 * kMotionSize + k], 0.25 * difference, tolerance) << k;
  }
  for (const auto& [part, key] : {std::pair(0.2, 1), std::pair(0.8, 2)}) {
    std::vector<float> of_near(3 * kMotionSize);
    add_motion_gradient(d_pose, start.translation(), motions, {1, 2, part}, of_near);
    for (std::size_t k = 0; k < kMotionSize; ++k) {
      EXPECT_EQ(of_near[kMotionSize * (3 - key) + k], 0) << part << " " << k;
      EXPECT_NEAR(of_near[kMotionSize * key + k], 4 * gradient[2 * kMotionSize + k], 1e-5);
    }
  }
}

TEST(ActorMotion, LeavesOutAGradientThatIsNotFinite) {
  const std::vector<float> motions(2 * kMotionSize);
  std::vector<float> gradient(2 * kMotionSize, 0.5f);
  for (const double bad : {1e300, std::numeric_limits<double>::quiet_NaN()}) {  // 1e300: no float
    GaussianPoseGradient<NumberMath<double>> d_pose{};
    d_pose.rotation[1] = bad;
    EXPECT_FALSE(add_motion_gradient(d_pose, {1, 2, 3}, motions, {0, 1, 0.5}, gradient));
  }
  EXPECT_EQ(gradient, std::vector<float>(2 * kMotionSize, 0.5f));
}

TEST(ActorMotion, UpdatesKeysWithAGradientWithinBoundsAndSmoothly) {
  constexpr std::size_t kKeys = 6, n = kKeys * kMotionSize;
  std::vector<float> gradients(n), motions(n), first(n), second(n);
  const auto at = [&](std::vector<float>& of, std::size_t key, std::size_t k) -> float& {
    return of[kMotionSize * key + k];
  };
  at(gradients, 1, 0) = 3;
  at(gradients, 2, 0) = -2;
  at(motions, 2, 0) = 0.3f;  // a jump of one key
  at(gradients, 4, 4) = -1;
  at(motions, 3, 4) = at(motions, 4, 4) = at(motions, 5, 4) = 10 * kMaxMotion_rad;
  at(gradients, 0, 2) = 1;
  at(motions, 0, 2) = -10 * kMaxMotion_m;
  at(motions, 5, 1) = 0.2f;
  at(second, 5, 1) = 1;  // had a gradient in another step
  update_motions(adam_step(0, 1), 0.01f, gradients, motions, first, second);
  EXPECT_NEAR(at(motions, 1, 0), -0.01f + 0.02f * 0.3f, 1e-3f);
  EXPECT_NEAR(at(motions, 2, 0), 0.31f - 0.04f * 0.3f, 1e-3f);
  EXPECT_NEAR(at(motions, 3, 0), 0.15f, 1e-6f) << "never had a gradient: between its neighbours";
  EXPECT_EQ(at(motions, 4, 4), kMaxMotion_rad);
  EXPECT_EQ(at(motions, 0, 2), -kMaxMotion_m);
  EXPECT_EQ(at(motions, 5, 1), 0.2f);
}

}  // namespace
}  // namespace redrive
