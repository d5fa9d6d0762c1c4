// SPDX-License-Identifier: Apache-2.0
// Scans of a model whose depth is a formula, from a car that moves while the sensor turns.
#include "redrive/render/lidar_scan.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/render/made_field_testing.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/render/recorded_lidar.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

/// A wall of the world, x = 30 m.
constexpr float kWall_m = 30;

class LidarScanTest : public ::testing::Test {
 protected:
  LidarScanTest() {
    model_.config.width = 32;
    model_.samples = 4;
    model_.near_m = 1;
    model_.far_m = 10;
    model_.parameters = Buffer<float>(nerf_parameter_count(model_.config));
    recording_.reader = aimotive::make_reader();
    recording_.lidars = {{"lidar", Rigid3d(Eigen::Translation3d(1.2, 0.1, 1.7))}};
    recording_.lidars[0].body_from_lidar.rotate(Eigen::AngleAxisd(0.3, Vector3d::UnitZ()));
    motion_.body_from_sensor = recording_.lidars[0].body_from_lidar;
  }
  LidarScan scan(const LidarFirings& firings, const ScanOptions& options = {}) {
    return render_scan(wall_, model_, firings, motion_, options);
  }
  LidarFirings spin() const {
    LidarSensor lidar = *parse_lidar_sensor("-5,0,5");
    lidar.azimuth_steps = 36;
    return lidar.revolution(recording_.frames[2].t_ns);
  }

  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path);  // 15 m/s, turns by 1.5 rad/s
  const Scene scene_ = make_scene(recording_, {});
  SensorMotion motion_{scene_};
  NerfModel model_;
  PaintBackend wall_{[](const auto&, const auto&) { return std::array<float, 3>{}; },
                     [](const auto& origin, const auto& direction) {
                       return direction[0] > 0 ? (kWall_m - origin[0]) / direction[0] : 0;
                     }};
};

TEST_F(LidarScanTest, RaysStartWhereTheSensorIsAtTheirTime) {
  const LidarFirings firings = spin();
  ScanOptions options;
  options.max_range_m = 100;
  for (const PointAxes axes : {PointAxes::kSensor, PointAxes::kBody, PointAxes::kWorld}) {
    options.axes = axes;
    const LidarScan scanned = scan(firings, options);
    EXPECT_GT(scanned.points.size(), 30u);
    EXPECT_GT(scanned.lost, 30u);
    EXPECT_EQ(scanned.points.size() + scanned.lost + scanned.out_of_range, firings.size());
    for (const LidarRecord& point : scanned.points) {
      const Rigid3d body = motion_.world_from_body(point.t_ns);
      const Vector3d in_world =
          axes == PointAxes::kWorld ? point.position_m
          : axes == PointAxes::kBody
              ? Vector3d(body * point.position_m)
              : Vector3d(body * recording_.lidars[0].body_from_lidar * point.position_m);
      // Floats of 30 m, over the cosine of the incidence: 100 m / 30 m at most.
      EXPECT_NEAR(in_world.x(), kWall_m, 1e-4);
    }
  }
}

TEST_F(LidarScanTest, DropsWhatIsOutOfRange) {
  const LidarFirings firings = spin();
  ScanOptions options;
  options.min_range_m = 29;
  options.max_range_m = 31;
  const LidarScan scanned = scan(firings, options);
  EXPECT_GT(scanned.points.size(), 0u);
  EXPECT_GT(scanned.out_of_range, 0u);
  for (const LidarRecord& point : scanned.points) {
    EXPECT_GE(point.position_m.norm(), 29);
    EXPECT_LE(point.position_m.norm(), 31);
  }
}

TEST_F(LidarScanTest, RaysThatTheVehicleStopsAreLost) {
  const LidarFirings firings = spin();
  const LidarScan all = scan(firings, {});
  ASSERT_GT(all.points.size(), 0u);
  ScanOptions options;
  const std::uint32_t stopped = all.firing[0];
  options.blind.insert(
      BlindDirections::cell_of(motion_.body_from_sensor.linear() * firings.direction[stopped]));
  const LidarScan some = scan(firings, options);
  EXPECT_LT(some.points.size(), all.points.size());
  EXPECT_EQ(some.points.size() + some.lost, all.points.size() + all.lost);
  EXPECT_EQ(std::ranges::count(some.firing, stopped), 0);
}

TEST_F(LidarScanTest, ShiftsAlongTheAxesOfTheSensor) {
  motion_.axes = ShiftAxes::kCamera;
  motion_.shift_m = {0, 2, 0};
  const std::int64_t t_ns = recording_.frames[1].t_ns + 7'000'000;
  const Vector3d moved =
      motion_.world_from_sensor(t_ns).translation() -
      (motion_.world_from_body(t_ns) * recording_.lidars[0].body_from_lidar).translation();
  EXPECT_LT((moved - motion_.world_from_sensor(t_ns).linear().col(1) * 2).norm(), 1e-9);
}

// The recorded revolution of the wall comes back: same directions, times and ranges.
TEST_F(LidarScanTest, RecordedFiringsReturnTheRecordedPoints) {
  std::vector<LidarRecord> points;
  for (int i = 0; i < 20; ++i) {
    const std::int64_t t_ns = recording_.frames[2].t_ns + (i / 4 - 2) * 10'000'000;
    const Rigid3d body = motion_.world_from_body(t_ns);
    points.push_back({body.inverse(Eigen::Isometry) * Vector3d(kWall_m, i - 10, i % 4), t_ns});
  }
  folder_.write("frame_12.las", make_las(points));
  recording_.lidar_files = {{12, folder_.path / "frame_12.las"}};
  ThreadPool pool(2);
  EXPECT_FALSE(recorded_firings(recording_, scene_, 11, pool));
  const auto firings = recorded_firings(recording_, scene_, 12, pool);
  ASSERT_TRUE(firings);
  ASSERT_EQ(firings->size(), 20u);
  ScanOptions options;
  options.axes = PointAxes::kBody;
  const LidarScan scanned = scan(*firings, options);
  ASSERT_EQ(scanned.points.size(), 20u);
  for (std::size_t i = 0; i < 20; ++i) {
    // 0.1 mm of the file, stretched by the incidence on the wall.
    EXPECT_LT((scanned.points[i].position_m - points[i].position_m).norm(), 0.0004) << i;
    EXPECT_EQ(scanned.points[i].t_ns, points[i].t_ns);
  }
}

/// Every ray meets something 10 m away; the first one an object at 5 m.
class ObjectAhead : public MadeField {
  RenderedRays trace(kernels::Backend& backend, const kernels::Rays& rays,
                     const std::vector<MovingObject>& actors = {}) const override {
    RenderedRays out = MadeField::trace(backend, rays);
    if (!actors.empty()) out.depth[0] = 5;
    return out;
  }
};

/// Loses rays with the probability `lost`.
MadeField losing_field(float lost) {
  MadeField field;
  field.has_signals = true;
  field.formula = [lost](const auto&, const auto&) { return MadeField::Ray{10, lost, 0.25f}; };
  return field;
}

TEST_F(LidarScanTest, PointsHaveWhatTheFieldAndTheSensorKnow) {
  const LidarFirings firings = spin();
  LidarScan scanned = render_scan(wall_, MadeField(), firings, motion_, {});
  EXPECT_FALSE(scanned.has_intensity);
  ASSERT_EQ(scanned.points.size(), firings.size());
  EXPECT_EQ(scanned.points[4].ring, 1);
  EXPECT_EQ(scanned.points[4].actor, kNoActor);
  EXPECT_EQ(scanned.points[4].loss, 0);
  EXPECT_EQ(scanned.points[4].range_m, 10);
  EXPECT_NEAR(scanned.points[4].azimuth_rad,
              std::atan2(firings.direction[4].y(), firings.direction[4].x()), 1e-6);

  scanned = render_scan(wall_, losing_field(0.25f), firings, motion_, {});
  EXPECT_TRUE(scanned.has_intensity);
  ASSERT_EQ(scanned.points.size(), firings.size());
  EXPECT_EQ(scanned.points[4].intensity, 0.25f);
  EXPECT_EQ(scanned.points[4].loss, 0.25f);
  EXPECT_EQ(render_scan(wall_, losing_field(0.75f), firings, motion_, {}).lost, firings.size());
}

TEST_F(LidarScanTest, LostRaysAreDrawnBySeed) {
  LidarSensor lidar = *parse_lidar_sensor("16");
  const LidarFirings firings = lidar.revolution(recording_.frames[2].t_ns);
  const MadeField field = losing_field(0.25f);
  const auto lost = [&](std::uint64_t seed) {
    ScanOptions options;
    options.seed = seed;
    return render_scan(wall_, field, firings, motion_, options).lost;
  };
  EXPECT_NEAR(static_cast<double>(lost(1)), 0.25 * firings.size(), 0.01 * firings.size());
  EXPECT_EQ(lost(1), lost(1));
  EXPECT_NE(lost(1), lost(2));
}

TEST_F(LidarScanTest, PointsOnMovingObjectsHaveTheirIds) {
  const LidarFirings firings = spin();
  Scene scene = scene_;
  SensorMotion motion{scene, recording_.lidars[0].body_from_lidar};
  const Rigid3d sensor = motion.world_from_sensor(firings.t_ns[0]);
  MovingObject object;
  object.id = 0;
  object.size_m = {1, 1, 1};
  for (const std::int64_t off_ns : {-1'000'000, 1'000'000})
    object.keys.push_back({firings.t_ns[0] + off_ns,
                           Rigid3d(Eigen::Translation3d(sensor * (5 * firings.direction[0]))),
                           Vector3d::Zero()});
  scene.actors = {object};
  const LidarScan scanned = render_scan(wall_, ObjectAhead(), firings, motion, {});
  EXPECT_EQ(scanned.points[0].range_m, 5);
  EXPECT_EQ(scanned.points[0].actor, 0);
  EXPECT_EQ(scanned.points[1].actor, kNoActor) << "behind it";
}

TEST(LidarAxes, AreThoseOfACameraThatLooksAhead) {
  EXPECT_TRUE(
      (Mount{}.body_from_sensor() * camera_from_lidar_axes()).isApprox(Rigid3d::Identity(), 1e-15));
  const Mount mount{{1, 2, 3}, /*yaw_deg=*/90, /*pitch_deg=*/0, /*roll_deg=*/0};
  EXPECT_LT(((mount.body_from_sensor() * camera_from_lidar_axes()) * Eigen::Vector3d(5, 0, 0) -
             Eigen::Vector3d(1, 7, 3))
                .norm(),
            1e-12)
      << "yaw to the left";
}

}  // namespace
}  // namespace redrive
