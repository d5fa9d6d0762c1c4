// SPDX-License-Identifier: Apache-2.0
// Scans of a wall of the world, x = 30 m, by sensors on a car that moves.
#include "redrive/view/rendered_scans.h"

#include <algorithm>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive::view {
namespace {

using ::testing::HasSubstr;
using Colour = ScanRequest::Colour;

constexpr float kWall_m = 30;

class RenderedScansTest : public testing::Test {
 protected:
  RenderedScansTest() {
    run_.recording = make_test_recording(folder_.path);
    run_.recording.reader = aimotive::make_reader();
    run_.recording.lidars = {{"lidar", Rigid3d(Eigen::Translation3d(1.2, 0.1, 1.7))}};
    run_.scene = make_scene(run_.recording, {});
    run_.options.method = "nerf";
    run_.state.model = make_painted_model();
    std::vector<LidarRecord> points;
    add({kWall_m, 1, 2}, &points);
    add({kWall_m, -2, 1}, &points);
    add({kWall_m, -4, 1}, &points);
    const Eigen::Vector3d ray = Eigen::Vector3d(kWall_m, 5, 1) - eye();
    add(eye() + (1 - 0.1 / ray.norm()) * ray, &points);  // 0.1 m before the wall
    add({-20, 5, 1}, &points);                           // where there is no wall
    folder_.write("frame_12.las", make_las(points));
    run_.recording.lidar_files = {{12, folder_.path / "frame_12.las"}};
  }
  std::int64_t t_ns() const { return run_.recording.frames[2].t_ns; }
  Eigen::Vector3d eye() const {
    return run_.scene.world_from_body(t_ns()) *
           run_.recording.lidars[0].body_from_lidar.translation();
  }
  void add(const Eigen::Vector3d& in_world, std::vector<LidarRecord>* points) const {
    points->push_back(
        {run_.scene.world_from_body(t_ns()).inverse(Eigen::Isometry) * in_world, t_ns()});
  }
  RenderedScan scan(const ScanRequest& request, std::int64_t frame = 12) {
    RenderedScans scans(run_, backend_);
    std::optional<RenderedScan> made;
    scans.update(request, frame, run_.scene, &made);
    return *made;
  }
  std::string error_of(const ScanRequest& request, std::int64_t frame = 12) {
    try {
      scan(request, frame);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }

  TemporaryFolder folder_;
  redrive::Run run_;
  PaintBackend backend_{[](const auto&, const auto&) { return std::array<float, 3>{}; },
                        [](const auto& origin, const auto& direction) {
                          return direction[0] > 0 ? (kWall_m - origin[0]) / direction[0] : 0;
                        }};
};

TEST_F(RenderedScansTest, ColoursTheErrorsOfTheRecordedRays) {
  const RenderedScan made = scan({"recorded", Colour::kError});
  EXPECT_EQ(made.described["rays"], 5);
  EXPECT_EQ(made.described["returns"], 4);
  EXPECT_NEAR(made.described["error_m"].get<double>(), 0, 1e-3);  // LAS has 0.1 mm
  ASSERT_EQ(made.in_world.size(), 5u);
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(made.in_world[i].x(), kWall_m, 1e-3) << i;
  for (int i = 0; i < 3; ++i) EXPECT_EQ(made.colour[i], 255) << i;
  EXPECT_NEAR(made.colour[3], 128, 1);           // 0.1 m lies in the middle of 1 m and 1 cm
  EXPECT_NEAR(made.in_world[4].x(), -20, 1e-3);  // lost: where it was recorded
  EXPECT_EQ(made.colour[4], 0);
}

TEST_F(RenderedScansTest, ColoursRanges) {
  const RenderedScan made = scan({"recorded", Colour::kRange});
  ASSERT_EQ(made.in_world.size(), 4u);
  EXPECT_EQ(made.colour[0], range_colour((Eigen::Vector3d(kWall_m, 1, 2) - eye()).norm()));
  EXPECT_EQ(range_colour(0.1), 0);
  EXPECT_EQ(range_colour(10), 128);
  EXPECT_EQ(range_colour(1000), 255);
}

TEST_F(RenderedScansTest, PutsAnySensorInTheRecordedLidarsPlace) {
  for (const char* const sensor : {"vlp-16", "rs-lidar-m1", "64:-20:10"}) {
    const RenderedScan made = scan({sensor, Colour::kRange}, 11);
    const std::size_t rays = made.described["rays"];
    EXPECT_GT(rays, kMostMarchedRays / 2) << sensor;
    EXPECT_LE(rays, kMostMarchedRays) << sensor;
    EXPECT_GT(made.in_world.size(), 1000u) << sensor;
    EXPECT_TRUE(made.described["error_m"].is_null()) << sensor;
    for (const Eigen::Vector3f& point : made.in_world) EXPECT_NEAR(point.x(), kWall_m, 1e-2);
  }
}

TEST_F(RenderedScansTest, MakesAScanOnce) {
  RenderedScans scans(run_, backend_);
  EXPECT_THAT(scans.sensors(), testing::IsSupersetOf({"recorded", "estimated", "vlp-16"}));
  std::optional<RenderedScan> made;
  scans.update({"recorded"}, 12, run_.scene, &made);
  made->colour.clear();
  scans.update({"recorded"}, 12, run_.scene, &made);
  EXPECT_TRUE(made->colour.empty());
  scans.update({"vlp-16"}, 12, run_.scene, &made);
  EXPECT_FALSE(made->colour.empty());
}

TEST_F(RenderedScansTest, SaysWhyThereIsNone) {
  EXPECT_THAT(error_of({"recorded"}, 11), HasSubstr("no LiDAR revolution of this frame"));
  EXPECT_THAT(error_of({"vlp-16"}, 99), HasSubstr("no such frame"));
  EXPECT_THAT(error_of({"vlp-16", Colour::kIntensity}), HasSubstr("no intensities"));
  EXPECT_THAT(error_of({"estimated"}), HasSubstr("cannot be estimated"));  // five points
  run_.recording.lidars.clear();
  EXPECT_THAT(error_of({"vlp-16"}), HasSubstr("no LiDAR"));
  EXPECT_TRUE(RenderedScans(run_, backend_).sensors().empty());
}

}  // namespace
}  // namespace redrive::view
