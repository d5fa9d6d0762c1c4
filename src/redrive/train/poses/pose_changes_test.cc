// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/poses/pose_changes.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/scene/scene.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/train/poses/pose_refinement.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

const PoseBounds kBounds{0.45f, 0.04f, 0.05f};

class PoseChangesTest : public ::testing::Test {
 protected:
  void set(std::size_t at, const std::vector<float>& values) {
    std::ranges::copy(values, &corrections_.values[at]);
  }
  /// Returns the changes of the scene with the corrections applied.
  PoseChanges changes() const {
    Scene placed = scene_;
    placed.correct(corrections_);
    return pose_changes(placed, corrections_, kBounds);
  }
  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path);
  Scene scene_ = make_scene(recording_, {});
  PoseCorrections corrections_{scene_};
};

TEST_F(PoseChangesTest, ReportsCamerasInTheBodysAxes) {
  // FRONT's z looks along the body's x, its x to the right, its y down.
  set(corrections_.camera_slot(1), {0.1f, 0.2f, 0.4f, 0.01f, 0.02f, 0.03f});
  set(corrections_.time_slot(1), {0.004f});
  const CameraChange front = changes().cameras.at(1);
  EXPECT_EQ(front.name, "FRONT");
  EXPECT_LT((front.pose.translation_m - Eigen::Vector3d(0.4, -0.1, -0.2)).norm(), 1e-7)
      << front.pose.translation_m.transpose();
  EXPECT_LT((front.pose.rotation_rad - Eigen::Vector3d(0.03, -0.01, -0.02)).norm(), 1e-8);
  EXPECT_NEAR(front.time_offset_s, 0.004, 1e-9);
  EXPECT_FALSE(front.pose.at_bound);
  // Equals the change of the extrinsics.
  Scene after = scene_;
  after.correct(corrections_);
  const Rigid3d &was = scene_.rig[1].body_from_sensor, &is = after.rig[1].body_from_sensor;
  EXPECT_LT((is.translation() - was.translation() - front.pose.translation_m).norm(), 1e-7);
  const Eigen::AngleAxisd turn(is.linear() * was.linear().transpose());
  EXPECT_LT((turn.angle() * turn.axis() - front.pose.rotation_rad).norm(), 1e-7);
}

TEST_F(PoseChangesTest, ReportsFramesInTheirOwnAxes) {
  set(corrections_.frame_slot(2), {0.03f, 0, 0.04f, 0, 0.012f, 0});
  set(corrections_.frame_slot(4), {0, -0.05f, 0, 0.005f, 0, 0});
  const PoseChanges changes = this->changes();
  ASSERT_EQ(changes.frames.size(), 6u);
  EXPECT_LT((changes.frames[2].translation_m - Eigen::Vector3d(0.03, 0, 0.04)).norm(), 1e-8);
  EXPECT_NEAR(changes.translation_m, std::sqrt((0.05 * 0.05 + 0.05 * 0.05) / 6), 1e-8);
  EXPECT_NEAR(changes.rotation_rad, 0.013 / std::sqrt(6.0), 1e-8);
  EXPECT_EQ(at_bound(changes), "");
  EXPECT_THAT(describe_changes(changes), HasSubstr("frames by 2.9 cm and 0.304 degrees RMS\n"));
  EXPECT_THAT(describe_changes(changes), Not(HasSubstr("WARNING")));
}

TEST_F(PoseChangesTest, ReportsCorrectionsAtTheirBounds) {
  set(corrections_.frame_slot(1), {0, -kBounds.translation_m});
  set(corrections_.frame_slot(3) + 5, {0.99f * kBounds.rotation_rad});
  set(corrections_.frame_slot(4), {0.9f * kBounds.translation_m});
  set(corrections_.time_slot(0), {kBounds.time_offset_s});
  const PoseChanges changes = this->changes();
  EXPECT_EQ(changes.frames_at_bound(), 2);
  EXPECT_TRUE(changes.frames[1].at_bound && changes.frames[3].at_bound);
  EXPECT_TRUE(changes.cameras[0].pose.at_bound);
  EXPECT_FALSE(changes.cameras[1].pose.at_bound);
  EXPECT_EQ(at_bound(changes), "2 of 6 frames, FISHEYE");
  const std::string text = describe_changes(changes);
  EXPECT_THAT(text, HasSubstr("WARNING: 2 of 6 at their bounds"));
  EXPECT_THAT(text,
              HasSubstr("FISHEYE: by 0.0 cm, 0.000 degrees, +50.0 ms; WARNING: at its bound"));
  EXPECT_THAT(text, HasSubstr("FRONT: by 0.0 cm, 0.000 degrees, +0.0 ms\n"));
}

}  // namespace
}  // namespace redrive
