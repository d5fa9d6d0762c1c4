// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/lidar_ties.h"

#include <gtest/gtest.h>

#include "redrive/align/bundle/synthetic_rig_testing.h"

namespace redrive {
namespace {

/// A patch on the plane z = 1 + 0.1 x of the world around x = 8 m, from one revolution.
struct PatchedDrive {
  RigModel model;
  std::vector<LidarSample> lidar;
  PlanarPatch patch;

  PatchedDrive() {
    model = make_rig_model(testing::make_synthetic_rig({.points = 0, .lidar_points = 0}).recording);
    const std::int64_t t_ns = model.initial_frames[5].t_ns + 10'000'000;
    const Rigid3d body_from_world = model.motion_at(t_ns).world_from_body.inverse();
    for (int i = 0; i < 25; ++i) {
      const double x = 7 + 0.5 * (i % 5), y = -1 + 0.5 * (i / 5);
      lidar.push_back({body_from_world * Eigen::Vector3d(x, y, 1 + 0.1 * x), t_ns, 0});
      patch.samples.push_back(i);
    }
    patch.plane.centre = {8, 0, 1.75};
    patch.plane.value = {-0.1, 0, 0.05};  // z - 1.75 - 0.1 (x - 8) = 0.05
    patch.sigma_m = 0.02;
  }
  std::vector<LidarTie> ties(const Eigen::Vector3d& point) const {
    ThreadPool pool(2);
    return find_lidar_ties(model, lidar, {patch}, {std::nullopt, point}, 0.3, pool);
  }
};

TEST(LidarTies, ArePointsNearAPatch) {
  const PatchedDrive drive;
  const Eigen::Vector3d on_plane(8.2, 0.3, 1.82), normal = Eigen::Vector3d(-0.1, 0, 1).normalized();
  for (const double off_m : {-0.25, 0.0, 0.1}) {
    const std::vector<LidarTie> ties = drive.ties(on_plane + off_m * normal);
    ASSERT_EQ(ties.size(), 1u) << off_m;
    EXPECT_EQ(ties[0].point, 1u);
    EXPECT_NEAR(ties[0].distance_m, off_m, 1e-12);
    EXPECT_EQ(ties[0].t_ns, drive.lidar[0].t_ns);
    const Rigid3d world_from_body = drive.model.motion_at(ties[0].t_ns).world_from_body;
    EXPECT_LT((world_from_body * ties[0].surface.in_body - on_plane).norm(), 1e-9);
    EXPECT_LT((world_from_body.linear() * ties[0].surface.normal - normal).norm(), 1e-9);
    EXPECT_NEAR(ties[0].surface.sigma_m, std::hypot(0.02, 0.01), 1e-12);
  }
  EXPECT_TRUE(drive.ties(on_plane + 0.35 * normal).empty()) << "too far from the plane";
  EXPECT_TRUE(drive.ties(on_plane + Eigen::Vector3d(2, 0, 0.2)).empty()) << "beyond the patch";
}

// A wall that faces the car, 0.4 m behind a point on the slope.
TEST(LidarTies, LeaveOutCorners) {
  PatchedDrive drive;
  const Eigen::Vector3d point(8.2, 0.3, 1.82);
  ASSERT_EQ(drive.ties(point).size(), 1u);
  const Rigid3d world_from_body = drive.model.motion_at(drive.lidar[0].t_ns).world_from_body;
  PlanarPatch wall;
  wall.plane.centre = {8.6, 0.3, 2};
  wall.plane.axes << 0, 0, 1, 1, 0, 0, 0, 1, 0;  // columns: y, z, x
  wall.samples = {static_cast<int>(drive.lidar.size())};
  wall.sigma_m = 0.02;
  drive.lidar.push_back(
      {world_from_body.inverse() * Eigen::Vector3d(8.6, 0.3, 1.9), drive.lidar[0].t_ns, 0});
  ThreadPool pool(1);
  const auto ties = [&] {
    return find_lidar_ties(drive.model, drive.lidar, {drive.patch, wall}, {point}, 0.3, pool)
        .size();
  };
  EXPECT_EQ(ties(), 0u);
  wall.plane.axes = drive.patch.plane.axes;  // faces as the slope does
  EXPECT_EQ(ties(), 1u);
}

TEST(LidarTies, PointsHavePositionsUpToADistance) {
  InverseDepthPoint point;
  point.anchor = {1, 2, 3};
  point.value = {0.5, -0.25, 0.1};
  ASSERT_TRUE(position_of(point, 40));
  EXPECT_LT((*position_of(point, 40) - Eigen::Vector3d(6, -0.5, 13)).norm(), 1e-12);
  EXPECT_FALSE(position_of(point, 9.9));
  point.value[2] = -0.001;
  EXPECT_FALSE(position_of(point, 40)) << "behind infinity";
}

}  // namespace
}  // namespace redrive
