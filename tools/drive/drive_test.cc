// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/base/rng.h"
#include "redrive/edit/view_requests.h"
#include "redrive/image/image_io.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/recording_reader.h"
#include "tools/drive/write_drive.h"

namespace redrive::drive {
namespace {

using Eigen::Vector3d;

double uniform(std::uint64_t index, double low, double high) {
  return low + (high - low) * random_unit(random_key(5, kStreamTest), index);
}

Primitive shape_at(Shape shape, const Vector3d& centre, const Vector3d& half) {
  Primitive p;
  p.shape = shape;
  p.a = centre;
  p.b = half;
  return p;
}

TEST(Caster, DistancesFollowTheFormulas) {
  std::vector<Primitive> primitives{
      shape_at(Shape::kBox, {-5, 0, 1}, {1, 2, 1}),
      shape_at(Shape::kCylinder, {5, 0, 1}, {0.5, 0.5, 1}),
      shape_at(Shape::kEllipsoid, {0, 5, 1}, {1, 2, 0.5}),
  };
  primitives[0].cos_yaw = primitives[0].sin_yaw = std::sqrt(0.5);
  Primitive triangle;
  triangle.shape = Shape::kTriangle;
  triangle.a = {-100, -100, 0}, triangle.b = {100, -100, 0}, triangle.c = {0, 200, 0};
  primitives.push_back(triangle);
  const Caster caster(primitives);
  const Vector3d origin(0, 0, 1);
  EXPECT_NEAR(caster.cast(origin, {1, 0, 0}).distance_m, 4.5, 1e-12);
  EXPECT_NEAR(caster.cast(origin, {0, 1, 0}).distance_m, 3, 1e-12);
  EXPECT_NEAR(caster.cast(origin, {0, 0, -1}).distance_m, 1, 1e-12);
  // The box is turned by 45 degrees: its side is at x + y = -5 + sqrt(2) or further.
  EXPECT_NEAR(caster.cast(origin, {-1, 0, 0}).distance_m, 5 - std::sqrt(2.0), 1e-12);
  EXPECT_NEAR(caster.cast({5, 0, 9}, {0, 0, -1}).distance_m, 7, 1e-12) << "the cylinder's end";
  EXPECT_FALSE(caster.cast(origin, {0, -1, 0}).found());
  EXPECT_TRUE(caster.is_occluded(origin, {1, 0, 0}));
  EXPECT_FALSE(caster.is_occluded(origin, {0, 0, 1}));
  EXPECT_NEAR(caster.cast(origin, {0, 1, 0}).normal.y(), -1, 1e-12);
}

TEST(Caster, HierarchyFindsWhatAllPrimitivesHave) {
  const World world(3, -30, 60);
  const std::vector<Primitive>& primitives = world.caster().primitives();
  int found = 0;
  for (std::uint64_t i = 0; i < 2000; ++i) {
    const Vector3d origin =
        world.road().position(uniform(5 * i, -5, 30), uniform(5 * i + 1, -2, 2), 1.5);
    const Vector3d direction = Vector3d(uniform(5 * i + 2, -1, 1), uniform(5 * i + 3, -1, 1),
                                        uniform(5 * i + 4, -0.5, 0.5))
                                   .normalized();
    Hit nearest;
    for (std::size_t k = 0; k < primitives.size(); ++k)
      intersect(primitives[k], static_cast<int>(k), origin, direction, &nearest);
    const Hit hit = world.caster().cast(origin, direction);
    ASSERT_EQ(hit.distance_m, nearest.distance_m) << i;
    ASSERT_EQ(world.caster().is_occluded(origin, direction), nearest.found());
    found += hit.found();
  }
  EXPECT_GT(found, 1500);
}

TEST(Road, IsOneMetreLongEveryMetreAndTheSameForAnyLength) {
  const Road road(7, -50, 400), longer(7, -90, 4000);
  for (double s = -49; s < 399; s += 3.7) {
    const Vector3d step = road.position(s + 1e-3) - road.position(s - 1e-3);
    EXPECT_NEAR(step.head<2>().norm(), 2e-3, 1e-8) << s;
    EXPECT_NEAR(step.z() / 2e-3, road.slope(s), 1e-6) << s;
    EXPECT_EQ(road.position(s, 2), longer.position(s, 2)) << s;
  }
  // The road 1 km on is another one.
  EXPECT_GT(std::abs(longer.heading_rad(1000) - longer.heading_rad(0)) +
                std::abs(longer.heading_rad(1100) - longer.heading_rad(100)),
            0.05);
}

TEST(Road, ALoopMeetsItself) {
  const Road road(7, -50, 700, 300);
  for (double s = -49; s < 399; s += 3.7) {
    EXPECT_LT((road.position(s, 2) - road.position(s + 300, 2)).norm(), 1e-6) << s;
    const Vector3d step = road.position(s + 1e-3) - road.position(s - 1e-3);
    EXPECT_NEAR(step.z() / 2e-3, road.slope(s), 1e-6) << s;
  }
  EXPECT_GT((road.position(0) - road.position(150)).norm(), 60);
}

TEST(Motion, ErrorsOfPosesHaveTheirSizeAndCorrelation) {
  Vector6d squares = Vector6d::Zero();
  double correlation = 0;
  constexpr int kFrames = 4000;
  for (int f = 0; f < kFrames; ++f) {
    const Vector6d error = pose_error(1, f);
    squares += error.cwiseAbs2() / kFrames;
    correlation += error.x() * pose_error(1, f + 7).x() / kFrames;
  }
  // 4000 frames are 230 independent ones: 5 % of an RMS.
  EXPECT_NEAR(std::sqrt(squares[0]), 0.06, 0.009);
  EXPECT_NEAR(std::sqrt(squares[2]), 0.03, 0.005);
  EXPECT_NEAR(std::sqrt(squares[5]) / kRadiansPerDegree, 0.12, 0.02);
  EXPECT_NEAR(correlation / squares[0], std::exp(-0.5), 0.12);
}

class MadeDrive : public ::testing::Test {
 protected:
  static DriveOptions options() {
    DriveOptions options;
    options.length_m = 3;
    options.cameras = 4;
    options.size = 0.2;
    options.lidar_beams = 8;
    options.lidar_noise_m = 0;
    options.novel_every = 2;
    return options;
  }
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    ThreadPool pool(2);
    write_drive(folder_->path, options(), pool);
  }
  static void TearDownTestSuite() { delete folder_; }

  static TemporaryFolder* folder_;
};
TemporaryFolder* MadeDrive::folder_ = nullptr;

TEST_F(MadeDrive, IsReadBack) {
  const Recording recording = open_recording(folder_->path);
  EXPECT_EQ(recording.format, "aimotive");
  EXPECT_EQ(recording.frames.size(), 3u);
  EXPECT_EQ(recording.cameras.size(), 4u);
  EXPECT_EQ(recording.lidar_files.size(), 3u);
  EXPECT_EQ(recording.novel.size(), novel_shifts().size());
  EXPECT_TRUE(recording.findings.empty()) << recording.findings[0].what;
  const Recording exact = open_recording(folder_->path, PoseSource::kGroundTruth);
  const World world = make_world(options());
  const Motion motion(world.road(), 10);
  for (int f = 0; f < 3; ++f) {
    const Rigid3d relative =
                      exact.frames[0].global_from_body.inverse() * exact.frames[f].global_from_body,
                  expected =
                      motion.world_from_body(0).inverse() * motion.world_from_body(time_s(f));
    EXPECT_LT((relative.matrix() - expected.matrix()).norm(), 1e-8) << f;
    const double error_m = (recording.frames[f].global_from_body.translation() -
                            exact.frames[f].global_from_body.translation())
                               .norm();
    EXPECT_NEAR(error_m, pose_error(options().seed, f).head<3>().norm(), 1e-6) << f;
  }
  EXPECT_EQ(exact.find_camera("M_FISHEYE_L")->calibration.time_offset_ns, -12'000'000);
  EXPECT_EQ(recording.find_camera("M_FISHEYE_L")->calibration.time_offset_ns, 0);
  for (const NovelSet& set : recording.novel)
    EXPECT_EQ(read_view_requests(set.poses_file).views.size(), 1u) << set.name;
}

TEST_F(MadeDrive, LidarRangesAreThoseOfTheSensorAtEachPointsTime) {
  const Recording recording = open_recording(folder_->path, PoseSource::kGroundTruth);
  const World world = make_world(options());
  const Motion motion(world.road(), 10);
  int points = 0, equal = 0;
  for (const FrameFile& file : recording.lidar_files)
    for (const LidarPoint& point : recording.reader->read_lidar(file)) {
      const Rigid3d pose =
          motion.world_from_body(1e-9 * static_cast<double>(point.t_ns - time_ns(0)));
      const Vector3d from_sensor =
          point.in_body_m.cast<double>() - recording.lidars[0].body_from_lidar.translation();
      const double range_m = from_sensor.norm();
      const Vector3d direction = pose.linear() * from_sensor / range_m;
      // Coordinates are rounded to 0.1 mm, so rays along silhouettes and at grazing angles miss.
      const double found_m =
          world.range(pose * recording.lidars[0].body_from_lidar.translation(), direction)
              .distance_m;
      equal += std::abs(found_m - range_m) < 0.004 * std::max(1.0, range_m / 10);
      ++points;
    }
  EXPECT_GT(points, 3000);
  EXPECT_GT(equal, 0.985 * points);
}

// Returns of the LiDAR lie where the depth of a shifted camera's pixel has them.
TEST_F(MadeDrive, DepthOfShiftedViewsHoldsTheLidarsReturns) {
  const Recording recording = open_recording(folder_->path, PoseSource::kGroundTruth);
  const World world = make_world(options());
  const Motion motion(world.road(), 10);
  const CameraCalibration calibration = true_rig(options())[0];
  const Camera camera = make_camera(calibration);
  const int frame = 1;
  for (const NovelShift& novel : novel_shifts()) {
    const std::filesystem::path folder = folder_->path / "novel" / novel.name;
    const Image16 depth = read_png16(folder / "F_MIDLONGRANGECAM_CL_0001001_depth.png");
    Rigid3d body = motion.world_from_body(time_s(frame));
    body.translate(novel.shift_body_m);
    const Rigid3d camera_from_world = (body * calibration.body_from_sensor).inverse();
    int seen = 0, agree = 0;
    for (const LidarPoint& point : recording.reader->read_lidar(recording.lidar_files[frame])) {
      const Rigid3d at =
          motion.world_from_body(1e-9 * static_cast<double>(point.t_ns - time_ns(0)));
      const Vector3d in_camera = camera_from_world * (at * point.in_body_m.cast<double>());
      const auto pixel = camera.project(in_camera);
      if (!pixel || pixel->x() < 0 || pixel->y() < 0 || pixel->x() > camera.width - 1 ||
          pixel->y() > camera.height - 1 || in_camera.norm() > 20)
        continue;
      const auto x = std::lround(pixel->x()), y = std::lround(pixel->y());
      const double depth_m = 1e-3 * depth.values[static_cast<std::size_t>(y * depth.width + x)];
      ++seen;
      agree += std::abs(depth_m - in_camera.norm()) < 0.05 * in_camera.norm();
    }
    EXPECT_GT(seen, 100) << novel.name;
    EXPECT_GT(agree, 0.8 * seen) << novel.name << ": others are hidden from the shifted camera";
  }
}

TEST_F(MadeDrive, ImagesDependOnNeitherThreadsNorLength) {
  DriveOptions longer = options();
  longer.length_m = 5;
  longer.cameras = 2;
  TemporaryFolder other;
  ThreadPool pool(1);
  write_drive(other.path, longer, pool);
  for (const char* name : {"sensor/camera/F_MIDRANGECAM_C/F_MIDRANGECAM_C_0001002.jpg",
                           "dynamic/raw-revolutions/frame_0001002.las",
                           "novel/left_1/F_MIDLONGRANGECAM_CL_0001001.jpg"})
    EXPECT_EQ(read_file(folder_->path / name), read_file(other.path / name)) << name;
  longer.seed = 2;
  TemporaryFolder another;
  write_drive(another.path, longer, pool);
  const char* name = "sensor/camera/F_MIDRANGECAM_C/F_MIDRANGECAM_C_0001002.jpg";
  EXPECT_NE(read_file(another.path / name), read_file(other.path / name));
}

TEST(Draw, GainBrightensAndShadesDiffer) {
  DriveOptions options;
  options.length_m = 3;
  options.size = 0.1;
  const World world = make_world(options);
  const Motion motion(world.road(), 10);
  const CameraCalibration camera = true_rig(options)[0];
  const CameraRays rays(make_camera(camera));
  const Rigid3d pose = motion.world_from_body(0) * camera.body_from_sensor;
  const auto mean = [](const Image8& image) {
    double sum = 0;
    for (const std::uint8_t value : image.rgb) sum += value;
    return sum / static_cast<double>(image.rgb.size());
  };
  const double bright = mean(draw(world, rays, pose, 1)), dark = mean(draw(world, rays, pose, 0.5));
  EXPECT_GT(bright, 60);
  EXPECT_LT(bright, 200);
  EXPECT_LT(dark, 0.85 * bright);
}

}  // namespace
}  // namespace redrive::drive
