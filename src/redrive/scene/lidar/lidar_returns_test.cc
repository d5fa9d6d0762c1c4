// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_returns.h"

#include <bit>
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las_testing.h"
#include "redrive/scene/lidar/lidar_gains.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

constexpr double kMillimetre_m = 1e-3;  // rounding of the files

class LidarReturnsTest : public ::testing::Test {
 protected:
  LidarReturnsTest() {
    recording_.reader = aimotive::make_reader();
    recording_.lidars = {{"lidar", Rigid3d(Eigen::Translation3d(kSensor))}};
    recording_.lidars[0].body_from_lidar.rotate(Eigen::AngleAxisd(1.5, Vector3d::UnitZ()));
  }

  /// A return from `in_world` at t_ns in the axes of the recording's files.
  LasRecord seen(const Vector3d& in_world, std::int64_t t_ns) {
    const Vector3d in_body = world_from_body(t_ns).inverse() * in_world;
    LasRecord record;
    record.x = static_cast<std::int32_t>(std::lround(in_body.x() * 1000));
    record.y = static_cast<std::int32_t>(std::lround(in_body.y() * 1000));
    record.z = static_cast<std::int32_t>(std::lround(in_body.z() * 1000));
    record.gps_time_bits = std::bit_cast<std::uint64_t>(static_cast<double>(t_ns));
    record.intensity = static_cast<std::uint16_t>(t_ns / 1'000'000 % 250);
    return record;
  }
  Rigid3d world_from_body(std::int64_t t_ns) const {
    return recording_.frames[0].global_from_body.inverse() * pose_at(recording_.frames, t_ns);
  }
  void add_file(std::int64_t frame, const std::vector<LasRecord>& points) {
    const std::string name = "frame_" + std::to_string(frame) + ".las";
    folder_.write(name, testing::las_file(points));
    recording_.lidar_files.push_back({frame, folder_.path / name});
  }
  LidarReturns load(const SceneOptions& options = {}, const std::vector<Box>& boxes = {},
                    const LidarSelection& selection = {}) {
    const Scene scene = make_scene(recording_, options);
    ThreadPool pool(3);
    return load_lidar_returns(recording_, scene,
                              MovingObjects(boxes, recording_.frames, scene.global_from_world),
                              pool, selection);
  }
  static inline const Vector3d kSensor{1.2, 0.1, 1.7};
  TemporaryFolder folder_;
  Recording recording_ =
      make_test_recording(folder_.path);  // frames 10..15, 1/15 s apart from 1 s on
};

// A wall is measured from six positions between the frames: its points are fixed in the world, and
// each ray starts at the sensor.
TEST_F(LidarReturnsTest, StaticPointsAreFixedInTheWorld) {
  const Vector3d wall(20, -4, 2);
  std::vector<std::int64_t> times;
  for (const FramePose& frame : recording_.frames) {
    times.push_back(frame.t_ns + 11'000'000);
    add_file(frame.id, {seen(wall, times.back())});
  }
  const LidarReturns returns = load();
  ASSERT_EQ(returns.n, 6u);
  ASSERT_EQ(returns.direction.size(), 18u);
  EXPECT_EQ(returns.t_ns, times);
  ASSERT_EQ(returns.intensity.size(), times.size());
  for (std::size_t i = 0; i < times.size(); ++i)
    EXPECT_EQ(returns.intensity[i], times[i] / 1'000'000 % 250);
  const Scene scene = make_scene(recording_, {});
  LidarPoses poses(scene, returns);
  ThreadPool pool(2);
  const LidarRays rays = rays_in_world(scene, returns, pool);
  for (std::size_t i = 0; i < returns.n; ++i) {
    EXPECT_LT((poses.at(i).translation() - world_from_body(times[i]) * kSensor).norm(), 1e-8) << i;
    EXPECT_NEAR(returns.direction_in_sensor(i).norm(), 1, 1e-6);
    EXPECT_LT((poses.in_world(i) - wall).norm(), kMillimetre_m) << i;
    const Eigen::Vector3f end = rays.origin_at(i) + returns.range_m[i] * rays.direction_at(i);
    EXPECT_LT((end.cast<double>() - wall).norm(), kMillimetre_m) << i;
  }
}

TEST(LidarRays, OfOneTimeTakeOnePose) {
  const std::vector<std::int64_t> t_ns = {5, 5, 7};
  int poses = 0;
  const LidarRays rays = fire(
      t_ns, [](std::size_t i) { return Vector3d::Unit(static_cast<Eigen::Index>(i)); },
      [&](std::int64_t time_ns) {
        ++poses;
        Rigid3d pose(Eigen::Translation3d(static_cast<double>(time_ns), 0, 0));
        pose.rotate(Eigen::AngleAxisd(std::numbers::pi / 2, Vector3d::UnitZ()));
        return pose;
      });
  EXPECT_EQ(poses, 2);
  EXPECT_EQ(rays.origin_at(2), Eigen::Vector3f(7, 0, 0));
  EXPECT_LT((rays.direction_at(0) - Eigen::Vector3f(0, 1, 0)).norm(), 1e-6);
  EXPECT_LT((rays.direction_at(1) - Eigen::Vector3f(-1, 0, 0)).norm(), 1e-6);
}

// Returns follow the poses when these are refined.
TEST_F(LidarReturnsTest, MoveWithCorrectedPoses) {
  add_file(12, {seen({20, -4, 2}, recording_.frames[2].t_ns)});
  const LidarReturns returns = load();
  Scene scene = make_scene(recording_, {});
  PoseCorrections corrections(scene);
  corrections.values[corrections.frame_slot(2)] = 0.5f;  // forward
  scene.correct(corrections);
  const Vector3d forward = world_from_body(recording_.frames[2].t_ns).linear().col(0),
                 moved = Vector3d(20, -4, 2) + 0.5 * forward;
  EXPECT_LT((LidarPoses(scene, returns).in_world(0) - moved).norm(), kMillimetre_m);
  EXPECT_LT((LidarPoses(scene, returns, Poses::kRecorded).in_world(0) - Vector3d(20, -4, 2)).norm(),
            kMillimetre_m);
}

TEST_F(LidarReturnsTest, DropsPointsRepeatedFromThePreviousFile) {
  const std::int64_t t_ns = recording_.frames[1].t_ns;
  const auto a = seen({20, 1, 1}, t_ns), b = seen({20, 2, 1}, t_ns), c = seen({20, 3, 1}, t_ns);
  const auto later = seen({20, 2, 1}, t_ns + 1000);
  add_file(10, {a, b});
  add_file(11, {b, c, later});
  const LidarReturns returns = load();
  EXPECT_EQ(returns.n, 4u);
  EXPECT_EQ(returns.repeated, 1u);
}

// Points of a held-out revolution reach neither training through the next revolution nor scores
// through the one before.
TEST_F(LidarReturnsTest, SelectsRevolutions) {
  const std::int64_t t_ns = recording_.frames[1].t_ns;
  const auto a = seen({20, 1, 1}, t_ns), b = seen({20, 2, 1}, t_ns), c = seen({20, 3, 1}, t_ns),
             d = seen({20, 4, 1}, t_ns);
  add_file(10, {a, b});
  add_file(11, {b, c});
  add_file(12, {c, d});
  const auto ranges = [](const LidarReturns& returns) {
    std::vector<float> sorted = returns.range_m;
    std::ranges::sort(sorted);
    return sorted;
  };
  const auto only = [](std::int64_t id) {
    return LidarSelection{[id](std::int64_t frame) { return frame == id; }};
  };
  const auto but = [](std::int64_t id) {
    return LidarSelection{[id](std::int64_t frame) { return frame != id; }};
  };
  const LidarReturns held_out = load({}, {}, only(11)), training = load({}, {}, but(11));
  EXPECT_EQ(held_out.n, 1u) << "c";
  EXPECT_EQ(held_out.repeated, 1u);
  EXPECT_EQ(training.n, 3u) << "a, b, d";
  EXPECT_EQ(training.repeated, 1u);
  std::vector<float> both = ranges(training);
  both.push_back(held_out.range_m[0]);
  std::ranges::sort(both);
  EXPECT_EQ(both, ranges(load()));
  LidarSelection whole = only(12);
  whole.repeated = true;
  EXPECT_EQ(load({}, {}, whole).n, 2u) << "c, d";
}

TEST_F(LidarReturnsTest, HeldOutFramesAreThoseOfHeldOutViews) {
  SceneOptions options;
  options.holdout_every = 2;
  EXPECT_EQ(held_out_frames(make_scene(recording_, options)), (std::set<std::int64_t>{10, 12, 14}));
  EXPECT_TRUE(held_out_frames(make_scene(recording_, {})).empty());
}

TEST_F(LidarReturnsTest, DropsPointsBeyondTheTrajectory) {
  const std::int64_t first_ns = recording_.frames.front().t_ns,
                     last_ns = recording_.frames.back().t_ns;
  add_file(10, {seen({20, 1, 1}, first_ns - 61'000'000), seen({20, 1, 1}, first_ns - 59'000'000),
                seen({20, 1, 1}, last_ns + 59'000'000), seen({20, 1, 1}, last_ns + 61'000'000)});
  const LidarReturns returns = load();
  EXPECT_EQ(returns.n, 2u);
  EXPECT_EQ(returns.beyond_trajectory, 2u);
}

TEST_F(LidarReturnsTest, DropsPointsOnTheEgoVehicle) {
  const std::int64_t t_ns = recording_.frames[2].t_ns;
  const Rigid3d here = world_from_body(t_ns);
  std::vector<LasRecord> points;
  for (const Vector3d& on_it :
       {Vector3d(3, 0.5, 0.9), Vector3d(1.7, -0.6, 1.5), kSensor, Vector3d(-1, 0.9, 1.2)})
    points.push_back(seen(here * on_it, t_ns));
  for (const Vector3d& beside :
       {Vector3d(3, 1.5, 0.9), Vector3d(5, 0, 0.9), Vector3d(-2, 0, 0.5), Vector3d(2, 0, 0)})
    points.push_back(seen(here * beside, t_ns));
  add_file(12, points);
  const LidarReturns returns = load();
  EXPECT_EQ(returns.on_ego, 4u);
  EXPECT_EQ(returns.n, 4u);
}

// Two cars side by side, one parked; the points on both are measured 40 ms after the time of the
// boxes.
TEST_F(LidarReturnsTest, DropsPointsOnMovingObjectsOnly) {
  const FramePose& frame = recording_.frames[2];
  const Rigid3d here = world_from_body(frame.t_ns);
  const Vector3d ego_m_per_s = (world_from_body(frame.t_ns + 100'000'000).translation() -
                                world_from_body(frame.t_ns - 100'000'000).translation()) /
                               0.2;
  const Vector3d parked(25, 2, 0.8), moving(25, -2, 0.8), velocity(-30, 0, 0);
  std::vector<Box> boxes(2);
  for (int i = 0; i < 2; ++i) {
    boxes[i].object_id = i;
    boxes[i].t_ns = frame.t_ns;
    boxes[i].body_from_box = here.inverse() * Eigen::Translation3d(i ? moving : parked);
    boxes[i].size_m = Vector3d(4, 2, 1.6);
    boxes[i].velocity_in_body_m_per_s =
        here.linear().transpose() * ((i ? velocity : Vector3d(0, 0, 0)) - ego_m_per_s);
  }
  const std::int64_t t_ns = frame.t_ns + 40'000'000;
  const Vector3d rear(1.9, 0, 0);
  add_file(12, {seen(parked + rear, t_ns), seen(moving + 0.04 * velocity + rear, t_ns),
                seen(moving + rear, t_ns)});
  const LidarReturns returns = load({}, boxes);
  EXPECT_EQ(returns.on_moving, 1u);
  EXPECT_EQ(returns.n, 2u);

  // Afterwards, likewise.
  LidarReturns later = load();
  EXPECT_EQ(later.n, 3u);
  take_out(make_scene(recording_, {}),
           MovingObjects(boxes, recording_.frames, recording_.frames[0].global_from_body), &later);
  EXPECT_EQ(later.n, 2u);
  EXPECT_EQ(later.on_moving, 1u);
  EXPECT_EQ(later.direction, returns.direction);
  EXPECT_EQ(later.range_m, returns.range_m);
  EXPECT_EQ(later.t_ns, returns.t_ns);
  EXPECT_EQ(later.intensity, returns.intensity);
  ASSERT_EQ(later.on_objects.size(), 1u);
  ASSERT_EQ(returns.on_objects.size(), 1u);
  EXPECT_EQ(later.on_objects[0].id, 1);
  EXPECT_EQ(later.on_objects[0].t_ns, t_ns);
  EXPECT_LT((later.on_objects[0].in_box - returns.on_objects[0].in_box).norm(), 1e-4);
  EXPECT_EQ(later.on_objects[0].intensity, t_ns / 1'000'000 % 250);
  EXPECT_EQ(later.on_objects[0].direction, returns.on_objects[0].direction);
  ASSERT_EQ(later.scan_ends.size(), 1u);
  EXPECT_EQ(later.scan_ends[0].returns, 2u);
  EXPECT_EQ(later.scan_ends[0].on_objects, 1u);
}

/// A revolution of 8 beams and 180 steps on a sphere; every 30th ray is lost.
TEST_F(LidarReturnsTest, FindsLostRaysAndTheEndsOfScans) {
  constexpr int kBeams = 8, kSteps = 180, kEvery = 30;
  recording_.lidars = {{"lidar", Rigid3d(Eigen::Translation3d(kSensor))}};
  for (const int frame : {1, 2}) {
    std::vector<LasRecord> points;
    for (int ray = 0; ray < kBeams * kSteps; ++ray) {
      const std::int64_t t_ns = recording_.frames[frame].t_ns + 333'333ll * (ray / kBeams);
      const double azimuth = -2 * M_PI * (ray / kBeams) / kSteps,
                   elevation = 0.05 * (ray % kBeams - 4);
      const Vector3d direction(std::cos(elevation) * std::cos(azimuth),
                               std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      if (ray % kEvery != 17)
        points.push_back(seen(world_from_body(t_ns) * (kSensor + 25 * direction), t_ns));
    }
    add_file(recording_.frames[frame].id, points);
  }
  EXPECT_TRUE(load().lost.empty()) << "unless they are asked for";
  const LidarReturns returns = load({}, {}, {.frame = {}, .repeated = false, .lost = true});
  ASSERT_EQ(returns.scan_ends.size(), 2u);
  EXPECT_EQ(returns.scan_ends[0].returns, returns.n / 2);
  EXPECT_EQ(returns.scan_ends[1].returns, returns.n);
  EXPECT_EQ(returns.lost.size(), 2u * kBeams * kSteps / kEvery);
  EXPECT_EQ(returns.scan_ends[1].lost, returns.lost.size());
  for (const LidarReturns::LostRay& lost : returns.lost) {
    const double beam = std::asin(double(lost.direction.z())) / 0.05 + 4;
    EXPECT_NEAR(beam, std::round(beam), 0.05);
    EXPECT_NEAR(double(lost.direction.norm()), 1, 1e-6);
  }
  EXPECT_EQ(returns.full_intensities()[0], 255);
}

/// Two LiDARs that see the same wall 20 m ahead: the second has intensities of half the first's.
class TwoLidarsTest : public LidarReturnsTest {
 protected:
  static constexpr double kGain = 0.5;

  TwoLidarsTest() {
    recording_.lidars.push_back({"second", Rigid3d(Eigen::Translation3d(kSecond))});
    recording_.lidars[1].body_from_lidar.rotate(Eigen::AngleAxisd(-0.4, Vector3d::UnitY()));
    for (std::size_t lidar = 0; lidar < 2; ++lidar)
      for (const FramePose& frame : recording_.frames) {
        std::vector<LasRecord> points;
        for (int i = 0; i < 2000; ++i) {
          // The sensors share their times, but not their points.
          const double y = -5 + 0.1 * (i % 100) + (lidar == 0 ? 0 : 0.03), z = 0.15 * (i / 100);
          points.push_back(seen({20, y, z}, frame.t_ns + 10'000ll * i));
          points.back().intensity = static_cast<std::uint16_t>(
              std::lround((lidar == 0 ? 1 : kGain) * (140 + 100 * std::sin(y))));
        }
        const std::string name = std::to_string(lidar) + "_" + std::to_string(frame.id) + ".las";
        folder_.write(name, testing::las_file(points));
        recording_.lidar_files.push_back({frame.id, folder_.path / name, lidar});
      }
  }
  static inline const Vector3d kSecond{2.1, -0.5, 0.9};
  ThreadPool pool_{2};
};

TEST_F(TwoLidarsTest, EachReturnStartsAtItsOwn) {
  const LidarReturns returns = load();
  ASSERT_EQ(returns.sensors.size(), 2u);
  ASSERT_EQ(returns.n, 2u * 6 * 2000);
  EXPECT_EQ(returns.repeated, 0u);
  ASSERT_EQ(returns.scan_ends.size(), 12u);
  const Scene scene = make_scene(recording_, {});
  const LidarRays rays = rays_in_world(scene, returns, pool_);
  LidarPoses poses(scene, returns);
  for (std::size_t i = 0; i < returns.n; i += 37) {
    const std::size_t sensor = i / 12'000;
    ASSERT_EQ(returns.sensor_of(i), sensor);
    const Vector3d origin = world_from_body(returns.t_ns[i]) * (sensor == 0 ? kSensor : kSecond);
    ASSERT_LT((poses.at(i).translation() - origin).norm(), 1e-8) << i;
    ASSERT_LT((rays.origin_at(i).cast<double>() - origin).norm(), 1e-5) << i;
    ASSERT_NEAR(poses.in_world(i).x(), 20, 2 * kMillimetre_m) << i;
    const Eigen::Vector3f end = rays.origin_at(i) + returns.range_m[i] * rays.direction_at(i);
    ASSERT_NEAR(end.x(), 20, 2 * kMillimetre_m) << i;
  }
  const LidarReturns second = load({}, {}, {.lidar = 1});
  ASSERT_EQ(second.n, 6u * 2000);
  EXPECT_EQ(second.sensor_of(0), 1u);
  EXPECT_EQ(second.range_m[0], returns.range_m[12'000]);
}

TEST_F(TwoLidarsTest, TheirGainsFollowFromWhatBothSee) {
  LidarReturns returns = load();
  const Scene scene = make_scene(recording_, {});
  const std::vector<LidarGains> gains = estimate_gains(scene, returns, pool_);
  ASSERT_EQ(gains.size(), 2u);
  EXPECT_EQ(gains[0].gain, 1);
  EXPECT_NEAR(gains[1].gain, kGain, 0.02 * kGain);
  // A gain that is known changes nothing, and makes intensities equal.
  returns.sensors[1].gain = gains[1].gain;
  EXPECT_NEAR(estimate_gains(scene, returns, pool_)[1].gain, gains[1].gain, 1e-6);
  const std::vector<float> full = returns.full_intensities();
  EXPECT_NEAR(float(returns.intensity[12'000]) / full[1], float(returns.intensity[0]) / full[0],
              0.02);
  // Surfaces that only one has seen do not tell.
  std::erase_if(recording_.lidar_files, [](const FrameFile& file) { return file.lidar == 0; });
  EXPECT_EQ(estimate_gains(scene, load(), pool_)[1].gain, 1);
}

TEST_F(TwoLidarsTest, ADamagedScanCostsItself) {
  recording_.most_damaged_percent = 20;
  std::filesystem::resize_file(recording_.lidar_files[7].path, 240);
  const LidarReturns returns = load();
  EXPECT_EQ(returns.n, 11u * 2000);
  ASSERT_TRUE(returns.damaged);
  EXPECT_TRUE(returns.damaged->what.starts_with("1 of 12 records")) << returns.damaged->what;
  std::erase_if(recording_.lidar_files, [](const FrameFile& file) { return file.lidar == 1; });
  EXPECT_EQ(load().n, 6u * 2000) << "a LiDAR without scans";
}

TEST_F(LidarReturnsTest, UsesRevolutionsOfAllFramesOfTheScene) {
  for (const FramePose& frame : recording_.frames)
    add_file(frame.id, {seen({20, 1, 1}, frame.t_ns)});
  SceneOptions options;
  options.first_frame = 11;
  options.last_frame = 14;
  options.frame_step = 3;
  options.holdout_every = 2;
  EXPECT_EQ(load(options).n, 4u);
}

// In the body axes of the recording's first frame, which are the world's, also if the scene begins
// later.
TEST_F(LidarReturnsTest, UsesAPointCloudWithoutRevolutions) {
  folder_.write("points.ply",
                "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float "
                "y\nproperty float z\n"
                "end_header\n20 -4 2\n-15 3 1\n");
  recording_.points_file = folder_.path / "points.ply";
  SceneOptions options;
  options.first_frame = 12;
  const LidarReturns returns = load(options);
  ASSERT_EQ(returns.n, 2u);
  const Scene scene = make_scene(recording_, options);
  LidarPoses poses(scene, returns);
  EXPECT_LT((poses.in_world(0) - Vector3d(20, -4, 2)).norm(), 1e-5);
  EXPECT_LT((poses.in_world(1) - Vector3d(-15, 3, 1)).norm(), 1e-5);
  EXPECT_EQ(returns.t_ns[1], recording_.frames[2].t_ns)
      << "behind the drive: the scene's first frame is the nearest";
  add_file(12, {seen({20, 1, 1}, recording_.frames[2].t_ns)});
  EXPECT_EQ(load(options).n, 1u) << "revolutions take precedence";
}

TEST_F(LidarReturnsTest, IsEmptyWithoutExtrinsics) {
  add_file(10, {seen({20, 1, 1}, recording_.frames[0].t_ns)});
  recording_.lidars.clear();
  EXPECT_EQ(load().n, 0u);
}

TEST_F(LidarReturnsTest, SaysWhyMostReturnsAreLost) {
  const std::int64_t now_ns = recording_.frames[2].t_ns;
  const auto finding = [&](const std::vector<LasRecord>& points) {
    recording_.lidar_files.clear();
    add_file(12, points);
    ThreadPool pool(1);
    const std::optional<Finding> lost =
        lost_returns(sample_returns(recording_, make_scene(recording_, {}), pool));
    return lost ? lost->what : "";
  };
  const LasRecord good = seen({20, 3, 1}, now_ns);
  LasRecord late = good;
  late.gps_time_bits = std::bit_cast<std::uint64_t>(static_cast<double>(now_ns) + 3.6e12);
  EXPECT_EQ(finding({good, good, late}), "");
  EXPECT_EQ(finding({good, late, late}).substr(0, 31), "2 of 3 returns are not used: 2 ");
  LasRecord near = good;
  near.x = 20, near.y = 3, near.z = 500;  // kilometres that are taken for metres
  EXPECT_NE(finding({near, near, good}).find("2 within the vehicle"), std::string::npos);
  LasRecord far = good;
  far.x *= 100, far.y *= 100;  // centimetres
  EXPECT_NE(finding({far, far, good}).find("are their lengths metres?"), std::string::npos);
  recording_.lidars.clear();
  EXPECT_EQ(finding({late}), "");
}

TEST_F(LidarReturnsTest, CountsReturnsThatAreNoNumbersInASample) {
  std::vector<LasRecord> points(40, seen({20, 5, 1}, recording_.frames[2].t_ns));
  add_file(12, points);
  ThreadPool pool(1);
  EXPECT_FALSE(unusable_returns(sample_returns(recording_, make_scene(recording_, {}), pool)));
  points[7].gps_time_bits = std::bit_cast<std::uint64_t>(std::nan(""));
  recording_.lidar_files.clear();
  add_file(12, points);
  const std::optional<Finding> unusable =
      unusable_returns(sample_returns(recording_, make_scene(recording_, {}), pool));
  ASSERT_TRUE(unusable);
  EXPECT_EQ(unusable->subject, "lidar");
  EXPECT_EQ(unusable->what.substr(0, 27), "1 return of 1 scan left out");
}

// A file that turns out to be damaged when it is read costs itself, and so does a return.
TEST_F(LidarReturnsTest, DamagedFilesAndReturnsAreLeftOutAndNamed) {
  const auto t_ns = [&](std::size_t frame) { return recording_.frames[frame].t_ns; };
  std::vector<LasRecord> points(40, seen({20, 5, 1}, t_ns(0)));
  points[7].gps_time_bits = std::bit_cast<std::uint64_t>(std::nan(""));
  add_file(10, points);
  add_file(11, {seen({21, 5, 1}, t_ns(1))});
  add_file(12, {seen({22, 5, 1}, t_ns(2))});
  std::filesystem::resize_file(recording_.lidar_files[1].path, 240);
  const LidarReturns returns = load();
  EXPECT_EQ(returns.n, 40u);
  EXPECT_EQ(returns.unusable, 1u);
  ASSERT_TRUE(returns.damaged);
  EXPECT_EQ(returns.damaged->subject, "lidar");
  EXPECT_NE(returns.damaged->what.find("1 of 3 records left out: frame 11: "), std::string::npos)
      << returns.damaged->what;
  std::filesystem::resize_file(recording_.lidar_files[2].path, 240);
  EXPECT_THROW(load(), InputError);
}

}  // namespace
}  // namespace redrive
