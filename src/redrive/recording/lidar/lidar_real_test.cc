// SPDX-License-Identifier: Apache-2.0
// LiDAR revolutions and boxes of a real recording; skipped where it is missing. Its SOURCE.md has
// the expected values.
#include <map>

#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/aimotive/aimotive_boxes.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/lidar/scan_structure.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

class RealLidar : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(root_)) GTEST_SKIP() << root_ << " is not here";
    recording_ = open_recording(root_);
    ASSERT_EQ(recording_.lidar_files.size(), 50u);
    ASSERT_EQ(recording_.box_files.size(), 50u);
  }
  const std::filesystem::path root_ = REDRIVE_SHARED "/data/aimotive_night";
  Recording recording_;
};

TEST_F(RealLidar, ReadsRevolutions) {
  std::vector<LidarPoint> before;
  for (std::size_t frame = 0; frame < 50; ++frame) {
    const std::filesystem::path& file = recording_.lidar_files[frame].path;
    SCOPED_TRACE(file);
    const std::string bytes = read_file(file);
    const std::vector<LidarPoint> points = parse_las(bytes, file);
    ASSERT_EQ(points.size(), little_endian<std::uint32_t>(bytes, 107));

    // The bounding box of the header, to half its scale of 1 mm.
    Eigen::Array3f least = points[0].in_body_m, most = least;
    int most_intensity = 0;
    for (const LidarPoint& point : points) {
      least = least.min(point.in_body_m.array());
      most = most.max(point.in_body_m.array());
      most_intensity = std::max<int>(most_intensity, point.intensity);
    }
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(most[axis],
                  little_endian<double>(bytes, 179 + 16 * static_cast<std::size_t>(axis)), 5e-4);
      EXPECT_NEAR(least[axis],
                  little_endian<double>(bytes, 187 + 16 * static_cast<std::size_t>(axis)), 5e-4);
    }
    EXPECT_LE(most_intensity, 255);
    EXPECT_GE(most_intensity, 250);

    // One revolution of 602 packets, one time each, 0.167 ms apart.
    std::vector<std::int64_t> packets_ns{points[0].t_ns};
    for (const LidarPoint& point : points) {
      if (point.t_ns != packets_ns.back()) packets_ns.push_back(point.t_ns);
    }
    EXPECT_EQ(packets_ns.size(), 602u);
    for (std::size_t i = 1; i < packets_ns.size(); ++i)
      EXPECT_NEAR(static_cast<double>(packets_ns[i] - packets_ns[i - 1]), 167e3, 2e3);
    const std::int64_t box_ns = aimotive::read_boxes(recording_.box_files[frame].path)[0].t_ns;
    EXPECT_NEAR(static_cast<double>(packets_ns.front() - box_ns), -67.7e6, 0.4e6);
    EXPECT_NEAR(static_cast<double>(packets_ns.back() - box_ns), 32.4e6, 0.4e6);

    // The previous revolution ends with the first third of this one, bit for bit.
    if (!before.empty()) {
      const auto shared = std::find_if(before.begin(), before.end(),
                                       [&](const auto& p) { return p.t_ns == points[0].t_ns; });
      const auto count = static_cast<std::size_t>(before.end() - shared);
      EXPECT_NEAR(static_cast<double>(count) / static_cast<double>(points.size()), 1.0 / 3, 0.05);
      ASSERT_LE(count, points.size());
      for (std::size_t i = 0; i < count; ++i) {
        ASSERT_EQ(shared[static_cast<std::ptrdiff_t>(i)].in_body_m, points[i].in_body_m) << i;
        ASSERT_EQ(shared[static_cast<std::ptrdiff_t>(i)].t_ns, points[i].t_ns) << i;
        ASSERT_EQ(shared[static_cast<std::ptrdiff_t>(i)].intensity, points[i].intensity) << i;
      }
      EXPECT_TRUE(count == points.size() || points[count].t_ns > before.back().t_ns);
    }
    before = points;
  }
}

/// Returns the number of points in the box, each translated by `sign` times the object's motion
/// between the times of point and box.
int points_inside(const Box& box, const std::vector<LidarPoint>& points, int sign) {
  const Rigid3d box_from_body = box.body_from_box.inverse();
  int inside = 0;
  for (const LidarPoint& point : points) {
    const double dt_s = static_cast<double>(box.t_ns - point.t_ns) * 1e-9;
    const Eigen::Vector3d in_body_m =
        point.in_body_m.cast<double>() + sign * dt_s * box.velocity_in_body_m_per_s;
    inside += ((box_from_body * in_body_m).array().abs() <= box.size_m.array() / 2).all();
  }
  return inside;
}

TEST_F(RealLidar, PointsLieInTheBoxes) {
  struct Sum {
    int frames = 0, inside = 0, uncompensated = 0, reversed = 0;
  };
  std::map<std::int64_t, Sum> objects;
  for (std::size_t frame = 0; frame < 50; frame += 7) {
    const std::vector<LidarPoint> points = read_las(recording_.lidar_files[frame].path);
    for (const Box& box : aimotive::read_boxes(recording_.box_files[frame].path)) {
      Sum& sum = objects[box.object_id];
      ++sum.frames;
      sum.inside += points_inside(box, points, 1);
      sum.uncompensated += points_inside(box, points, 0);
      sum.reversed += points_inside(box, points, -1);
    }
  }
  ASSERT_EQ(objects.size(), 8u);
  Sum all;
  for (const auto& [id, sum] : objects) {
    EXPECT_GT(sum.inside, 10 * sum.frames) << id;
    EXPECT_GT(sum.inside, sum.reversed) << id;
    all.inside += sum.inside;
    all.uncompensated += sum.uncompensated;
  }
  // So velocities are relative and in body axes, with one clock. Slow objects move less than the
  // errors of their boxes.
  EXPECT_GT(all.inside, 1.03 * all.uncompensated);
}

TEST_F(RealLidar, BoxesPointAlongTheirMotion) {
  // Object 0 changes lanes while the ego vehicle drives straight ahead at 30 m/s: its x axis
  // follows its path.
  int boxes = 0;
  for (const FrameFile& file : recording_.box_files) {
    for (const Box& box : aimotive::read_boxes(file.path)) {
      if (box.object_id != 0 || box.velocity_in_body_m_per_s.y() < 0.5) continue;
      const Eigen::Vector3d motion = box.velocity_in_body_m_per_s + Eigen::Vector3d(30, 0, 0);
      const Eigen::Vector3d axis = box.body_from_box.linear().col(0);
      EXPECT_GT(axis.y(), 0.015);
      EXPECT_NEAR(std::atan2(axis.y(), axis.x()), std::atan2(motion.y(), motion.x()), 0.01);
      ++boxes;
    }
  }
  EXPECT_GT(boxes, 5);
}

TEST_F(RealLidar, VelocityIsTheMotionInBodyCoordinates) {
  std::map<std::int64_t, std::vector<Box>> objects;
  for (const FrameFile& file : recording_.box_files)
    for (const Box& box : aimotive::read_boxes(file.path)) objects[box.object_id].push_back(box);
  for (const auto& [id, boxes] : objects) {
    const Eigen::Vector3d way_m =
        boxes.back().body_from_box.translation() - boxes.front().body_from_box.translation();
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const Box& box : boxes)
      mean += box.velocity_in_body_m_per_s / static_cast<double>(boxes.size());
    const double time_s = static_cast<double>(boxes.back().t_ns - boxes.front().t_ns) * 1e-9;
    EXPECT_LT((way_m / time_s - mean).norm(), 0.05) << id;
  }
}

// A Pandar64 with two returns a ray: 0.2 degrees a step at 10 Hz.
TEST_F(RealLidar, HasTheBeamsOfItsSensor) {
  const std::vector<std::vector<LidarPoint>> scans = {
      recording_.reader->read_lidar(recording_.lidar_files[10])};
  std::string why;
  const auto found = estimate_structure(scans, recording_.lidars[0].body_from_lidar, &why);
  ASSERT_TRUE(found) << why;
  EXPECT_EQ(found->sensor.beams.size(), 64u);
  EXPECT_NEAR(found->sensor.azimuth_steps, 1800, 5);
  EXPECT_NEAR(found->sensor.rate_hz, 10, 0.05);
  EXPECT_TRUE(found->sensor.clockwise);
  EXPECT_LT(found->residual_rad, 1e-4);
  const LidarSensor sheet = *parse_lidar_sensor("pandar64");
  double mean = 0;  // the estimate counts azimuths from their mean
  for (const LidarBeam& beam : sheet.beams) mean += beam.azimuth_rad / 64;
  for (std::size_t b = 0; b < 64; ++b) {
    EXPECT_NEAR(found->sensor.beams[b].elevation_rad, sheet.beams[b].elevation_rad, 1e-4) << b;
    EXPECT_NEAR(found->sensor.beams[b].azimuth_rad, sheet.beams[b].azimuth_rad - mean, 5e-4) << b;
  }
  EXPECT_NEAR(found->second_returns, 0.28, 0.01);
}

}  // namespace
}  // namespace redrive
