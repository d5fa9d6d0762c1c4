// SPDX-License-Identifier: Apache-2.0
// Four frames of a real sequence of PandaSet; skipped where they are missing.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "redrive/camera/camera.h"
#include "redrive/image/image_io.h"
#include "redrive/math/angles.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/core/trajectory.h"
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
  EXPECT_NEAR(recording_.lidars[0].body_from_lidar.translation().x(), 0.811, 0.005);
  const Rigid3d step =
      recording_.frames[0].global_from_body.inverse() * recording_.frames[3].global_from_body;
  EXPECT_NEAR(step.translation().x(), 2.37, 0.1);
  EXPECT_LT(step.translation().tail<2>().norm(), 0.05);
  EXPECT_EQ(recording_.lidar_files.size(), 6u);
  ASSERT_EQ(recording_.lidars.size(), 2u);
  const Rigid3d pandar64_from_gt =
      recording_.lidars[0].body_from_lidar.inverse() * recording_.lidars[1].body_from_lidar;
  EXPECT_NEAR(pandar64_from_gt.translation().x(), 0.606, 1e-3) << "ahead of the Pandar64";
  EXPECT_NEAR(pandar64_from_gt.translation().z(), -0.302, 1e-3);
  EXPECT_GT(pandar64_from_gt.linear()(0, 0), 0.99) << "looks ahead";
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
  const Rigid3d lidar_from_body = recording_.lidars[0].body_from_lidar.inverse();
  for (const LidarPoint& point : points) {
    const Eigen::Vector3d in_lidar = lidar_from_body * point.in_body_m.cast<double>();
    ++histogram[int(std::floor(std::asin(in_lidar.z() / in_lidar.norm()) / 1e-4))];
  }
  double squares = 0;
  for (const auto& [bin, count] : histogram) squares += double(count) * count;
  EXPECT_LT(double(points.size()) * double(points.size()) / squares, 1500)
      << "effective number of bins of 0.1 mrad; they would be some 2600 without the motion";
}

TEST_F(RealPandaSet, PointsOfThePandarGtLieAheadOnThePandar64s) {
  const std::vector<FrameFile> scans = recording_.scans_of(1);
  const std::vector<LidarPoint> ahead = recording_.reader->read_lidar(scans[1]),
                                around = recording_.reader->read_lidar(recording_.scans_of(0)[1]);
  ASSERT_EQ(ahead.size(), 62'273u);
  const Rigid3d gt_from_body = recording_.lidars[1].body_from_lidar.inverse();
  // The road 8 m to 15 m ahead, by cells of half a metre.
  std::map<std::pair<long, long>, std::vector<double>> heights[2];
  for (const LidarPoint& point : ahead) {
    const Eigen::Vector3d at = gt_from_body * point.in_body_m.cast<double>();
    EXPECT_LT(std::abs(std::atan2(at.y(), at.x())), 33 * kRadiansPerDegree);
  }
  for (const auto* points : {&around, &ahead})
    for (const LidarPoint& point : *points)
      if (const Eigen::Vector3f& p = point.in_body_m;
          p.x() > 8 && p.x() < 15 && std::abs(p.y()) < 2)
        heights[points == &ahead][{std::lround(2 * p.x()), std::lround(2 * p.y())}].push_back(
            p.z());
  std::vector<double> apart_m;
  for (auto& [cell, of_cell] : heights[0])
    if (const auto same = heights[1].find(cell); same != heights[1].end())
      apart_m.push_back(upper_median(of_cell) - upper_median(same->second));
  ASSERT_GT(apart_m.size(), 30u);
  EXPECT_LT(std::abs(upper_median(apart_m)), 0.05);
}

/// Edges of near things before far ones, by the side on which the far ones are: where the image has
/// its strongest vertical edge within 10 px, pixels to the right of the LiDAR's.
using EdgeOffsets = std::map<int, std::vector<double>>;

void add_edges(const Recording& recording, std::size_t f, EdgeOffsets* offsets) {
  const Rigid3d lidar_from_body = recording.lidars[0].body_from_lidar.inverse();
  struct Return {
    double azimuth_deg, range_m;
    Eigen::Vector3d in_lidar;
    std::int64_t t_ns;
  };
  std::map<int, std::vector<Return>> rings;
  for (const LidarPoint& point : recording.reader->read_lidar(recording.lidar_files[f])) {
    const Eigen::Vector3d p = lidar_from_body * point.in_body_m.cast<double>();
    const double azimuth_deg = std::atan2(-p.y(), p.x()) * 180 / M_PI;
    if (std::abs(azimuth_deg) < 28)
      rings[point.ring].push_back({azimuth_deg, p.norm(), p, point.t_ns});
  }
  const CameraCalibration& calibration = recording.cameras[0].calibration;
  const Camera camera = make_camera(calibration);
  const Image8 image = read_image(recording.cameras[0].images[f].path);
  const auto grey = [&](int x, int y) {
    const std::uint8_t* rgb = &image.rgb[3 * (std::size_t(y) * std::size_t(image.width) + x)];
    return rgb[0] + rgb[1] + rgb[2];
  };
  const Rigid3d camera_from_global =
      (recording.frames[f].global_from_body * calibration.body_from_sensor).inverse();
  for (auto& [ring, returns] : rings) {
    std::ranges::sort(returns, {}, &Return::azimuth_deg);
    for (std::size_t n = 1; n + 1 < returns.size(); ++n)
      for (const int side : {-1, 1}) {
        const Return &near = returns[n], &far = returns[n + std::size_t(side)],
                     &same = returns[n - std::size_t(side)];
        if (near.range_m > 40 || far.range_m - near.range_m < 2 ||
            std::abs(same.range_m - near.range_m) > 0.3 ||
            std::abs(far.azimuth_deg - near.azimuth_deg) > 0.25)
          continue;
        const Eigen::Vector3d between =
            near.range_m * (near.in_lidar.normalized() + far.in_lidar.normalized()).normalized();
        const auto pixel =
            camera.project(camera_from_global * (pose_at(recording.frames, near.t_ns) *
                                                 (recording.lidars[0].body_from_lidar * between)));
        if (!pixel || pixel->x() < 20 || pixel->x() > image.width - 20 || pixel->y() < 5 ||
            pixel->y() > image.height - 5)
          continue;
        const int x = int(std::lround(pixel->x())), y = int(std::lround(pixel->y()));
        int best = 0, strongest = 0;
        for (int dx = -10; dx <= 10; ++dx) {
          int edge = 0;
          for (const int dy : {-1, 0, 1})
            edge += (2 - std::abs(dy)) * (grey(x + dx + 1, y + dy) - grey(x + dx - 1, y + dy));
          if (std::abs(edge) > strongest) {
            strongest = std::abs(edge);
            best = dx;
          }
        }
        if (strongest > 200 && std::abs(best) < 10) (*offsets)[side].push_back(best);
      }
  }
}

TEST_F(RealPandaSet, DepthEdgesLieOnTheImages) {
  EdgeOffsets offsets;
  for (std::size_t f = 0; f < 3; ++f) add_edges(recording_, f, &offsets);
  ASSERT_GT(offsets[-1].size(), 80u);
  ASSERT_GT(offsets[1].size(), 80u);
  // The rays are 7 px apart, so a side is biased by what the LiDAR takes for an edge; both are not.
  const double shift_px = (upper_median(offsets[-1]) + upper_median(offsets[1])) / 2;
  EXPECT_LE(std::abs(shift_px), 2)
      << upper_median(offsets[-1]) << " left, " << upper_median(offsets[1]) << " right";
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
