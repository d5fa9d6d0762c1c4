// SPDX-License-Identifier: Apache-2.0
// Four frames of a real sequence of PandaSet; skipped where they are missing.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "redrive/camera/camera.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/upper_median.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

class RealPandaSet : public ::testing::Test {
 protected:
  void SetUp() override {
    const std::filesystem::path root = REDRIVE_SHARED "/data/pandaset/001";
    if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
    recording_ = open_recording(root);
  }
  Recording recording_;
};

TEST_F(RealPandaSet, ReadsWhatThereIs) {
  ASSERT_EQ(recording_.frames.size(), 4u);
  ASSERT_EQ(recording_.cameras.size(), 1u);
  const CameraCalibration& front = recording_.cameras[0].calibration;
  EXPECT_EQ(front.width, 1920);
  EXPECT_NEAR(front.body_from_sensor.translation().y(), 0, 0.02);
  EXPECT_NEAR(front.body_from_sensor.translation().z(), 2.08, 0.02);
  EXPECT_NEAR(front.body_from_sensor.linear()(0, 2), 1, 2e-3) << "looks ahead";
  EXPECT_NEAR(recording_.body_from_lidar->translation().x(), 0.811, 0.005);
  const Rigid3d step =
      recording_.frames[0].global_from_body.inverse() * recording_.frames[3].global_from_body;
  EXPECT_NEAR(step.translation().x(), 2.37, 0.1);
  EXPECT_LT(step.translation().tail<2>().norm(), 0.05);
  EXPECT_EQ(recording_.lidar_files.size(), 3u);
}

TEST_F(RealPandaSet, TheRoadIsAtHeightZero) {
  std::vector<double> heights;
  for (const LidarPoint& point : recording_.reader->read_lidar(recording_.lidar_files[1]))
    if (std::abs(point.in_body_m.y()) < 1.5f && point.in_body_m.x() > 5 && point.in_body_m.x() < 9)
      heights.push_back(point.in_body_m.z());
  ASSERT_GT(heights.size(), 100u);
  EXPECT_NEAR(upper_median(heights), 0, 0.1);
}

TEST_F(RealPandaSet, BeamsOfThePandar64HaveTheirElevations) {
  // A point's elevation at its own time repeats by beam, which it does not at the scan's time.
  std::map<int, int> histogram;
  const std::vector<LidarPoint> points = recording_.reader->read_lidar(recording_.lidar_files[1]);
  ASSERT_EQ(points.size(), 106'541u);
  const Rigid3d lidar_from_body = recording_.body_from_lidar->inverse();
  for (const LidarPoint& point : points) {
    const Eigen::Vector3d in_lidar = lidar_from_body * point.in_body_m.cast<double>();
    ++histogram[int(std::floor(std::asin(in_lidar.z() / in_lidar.norm()) / 1e-4))];
  }
  double squares = 0;
  for (const auto& [bin, count] : histogram) squares += double(count) * count;
  EXPECT_LT(double(points.size()) * double(points.size()) / squares, 1500)
      << "effective number of bins of 0.1 mrad; they would be some 2600 without the motion";
}

TEST_F(RealPandaSet, PointsLieInTheBoxes) {
  std::size_t inside = 0, boxes = 0;
  const std::vector<LidarPoint> points = recording_.reader->read_lidar(recording_.lidar_files[1]);
  for (const Box& box : recording_.reader->read_boxes(recording_.box_files[1])) {
    const Rigid3d global_from_box = pose_at(recording_.frames, box.t_ns) * box.body_from_box;
    if (box.body_from_box.translation().norm() > 25 || box.size_m.x() < 3) continue;
    ++boxes;
    const Rigid3d box_from_global = global_from_box.inverse();
    const auto hits = std::ranges::count_if(points, [&](const LidarPoint& point) {
      const Eigen::Vector3d in_box = box_from_global * (pose_at(recording_.frames, point.t_ns) *
                                                        point.in_body_m.cast<double>());
      return (in_box.cwiseAbs().array() <= box.size_m.array() / 2 + 0.1).all();
    });
    inside += hits > 20;
  }
  EXPECT_GT(boxes, 8u);
  EXPECT_GE(10 * inside, 8 * boxes) << inside << " of " << boxes;
}

}  // namespace
}  // namespace redrive
