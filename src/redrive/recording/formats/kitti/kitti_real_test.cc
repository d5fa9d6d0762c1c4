// SPDX-License-Identifier: Apache-2.0
// Excerpts of real drives of KITTI; skipped where they are missing.
#include <gtest/gtest.h>

#include "redrive/math/angles.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/scan_structure.h"

namespace redrive {
namespace {

class RealKitti : public ::testing::Test {
 protected:
  void open(const std::string& drive) {
    const std::filesystem::path root =
        REDRIVE_SHARED "/data/kitti/2011_09_26/2011_09_26_drive_" + drive + "_sync";
    if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
    recording_ = open_recording(root);
  }
  Recording recording_;
};

TEST_F(RealKitti, ReadsCamerasAndPoses) {
  open("0002");
  if (IsSkipped()) return;
  EXPECT_EQ(recording_.frames.size(), 10u);
  ASSERT_EQ(recording_.cameras.size(), 2u);
  const CameraCalibration &left = recording_.cameras[0].calibration,
                          &right = recording_.cameras[1].calibration;
  const Rigid3d right_from_left = right.body_from_sensor.inverse() * left.body_from_sensor;
  EXPECT_NEAR(right_from_left.translation().x(), -0.5327, 1e-4);
  EXPECT_NEAR(right_from_left.translation().y(), 0.0027, 1e-4);
  EXPECT_TRUE(right_from_left.linear().isApprox(Eigen::Matrix3d::Identity(), 1e-9));
  EXPECT_NEAR(left.body_from_sensor.translation().z(), 1.65, 0.06);
  EXPECT_NEAR(left.body_from_sensor.translation().y(), 0.06, 0.03);
  EXPECT_EQ(left.time_offset_ns, 0);
  EXPECT_NEAR(static_cast<double>(right.time_offset_ns), -0.6e6, 0.1e6);
  EXPECT_NEAR(left.body_from_sensor.linear()(0, 2), 1, 1e-3);  // looks ahead
  const Rigid3d step =
      recording_.frames[0].global_from_body.inverse() * recording_.frames[9].global_from_body;
  EXPECT_GT(step.translation().x(), 7);
  EXPECT_LT(step.translation().tail<2>().norm(), 0.5);
}

TEST_F(RealKitti, TheRoadIsAtHeightZero) {
  open("0013");
  if (IsSkipped()) return;
  ASSERT_EQ(recording_.lidar_files.size(), 28u);
  std::vector<float> heights;
  for (const LidarPoint& point : recording_.reader->read_lidar(recording_.lidar_files[0]))
    if (std::abs(point.in_body_m.y()) < 1.5 && point.in_body_m.x() > 5 && point.in_body_m.x() < 9)
      heights.push_back(point.in_body_m.z());
  ASSERT_GT(heights.size(), 1000u);
  std::nth_element(heights.begin(), heights.begin() + heights.size() / 2, heights.end());
  EXPECT_NEAR(heights[heights.size() / 2], 0, 0.08);
}

TEST_F(RealKitti, PointsLieInTheBoxes) {
  open("0013");
  if (IsSkipped()) return;
  ASSERT_EQ(recording_.box_files.size(), 28u);
  int frames = 0;
  for (std::size_t f = 0; f < recording_.box_files.size(); f += 9) {
    const std::vector<Box> boxes = recording_.reader->read_boxes(recording_.box_files[f]);
    const std::vector<LidarPoint> points = recording_.reader->read_lidar(recording_.lidar_files[f]);
    for (const Box& box : boxes) {
      if (box.object_id != 0 && box.object_id != 1) continue;
      int inside = 0, around = 0;
      for (const LidarPoint& point : points) {
        const Eigen::Array3d at =
            (box.body_from_box.inverse() * point.in_body_m.cast<double>()).array().abs();
        inside += (at <= box.size_m.array() / 2 + 0.05).all();
        // Not the road below: from 0.3 m above the bottom.
        around += (at.head<2>() <= box.size_m.array().head<2>() / 2 + 0.6).all() &&
                  at.z() <= box.size_m.z() / 2 - 0.3;
      }
      ++frames;
      EXPECT_GT(inside, 100) << box.object_id;
      EXPECT_GT(inside, 0.9 * around) << box.object_id;
    }
  }
  EXPECT_GT(frames, 4);
}

// The HDL-64E: its files have one ring after the other.
TEST_F(RealKitti, ScansHaveTheRingsOfTheirSensor) {
  open("0013");
  if (IsSkipped()) return;
  std::string why;
  const std::vector<std::vector<LidarPoint>> scans = {
      recording_.reader->read_lidar(recording_.lidar_files[5])};
  const auto found = estimate_structure(scans, recording_.lidars[0].body_from_lidar, &why);
  ASSERT_TRUE(found) << why;
  EXPECT_EQ(found->sensor.beams.size(), 64u);
  EXPECT_NEAR(found->sensor.azimuth_steps, 2083, 100);
  EXPECT_NEAR(found->sensor.rate_hz, 10, 0.5);
  EXPECT_TRUE(found->sensor.clockwise);
  EXPECT_LT(found->residual_rad, 0.15 * kRadiansPerDegree) << "its lasers do not share a centre";
}

}  // namespace
}  // namespace redrive
