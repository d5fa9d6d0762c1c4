// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/fill_ground.h"

#include <gtest/gtest.h>

#include "redrive/export/mesh/surfaces_testing.h"

namespace redrive {
namespace {

constexpr double kVoxel_m = 0.1;

/// The driven line: 1 m above the ground, along x.
std::vector<Eigen::Vector3d> driven_line() {
  std::vector<Eigen::Vector3d> driven;
  for (int x = 0; x <= 10; ++x) driven.emplace_back(x, 0, 1);
  return driven;
}

/// The ground z = 0 seen from above, within 4 m of the driven line.
TsdfVolume volume_of(const std::function<bool(double x, double y)>& has) {
  std::vector<DepthImage> images;
  const Surface ground =
      ground_surface([&](double x, double y) { return std::abs(y) < 4 && has(x, y); });
  for (int x = 0; x <= 10; x += 2)
    images.push_back(see(ground, right_angle_camera(200), looking({double(x), 0, 5}, {0, 0, -1})));
  ThreadPool pool(2);
  TsdfVolume volume(kVoxel_m, kAmpleMemory);
  volume.fuse(images, 20, pool);
  return volume;
}

/// Height of the surface in a column, or NaN.
double height(const TsdfVolume& volume, double x, double y) {
  const auto column = [&](int z) {
    return volume.find({static_cast<int>(std::lround(x / kVoxel_m)),
                        static_cast<int>(std::lround(y / kVoxel_m)), z});
  };
  for (int z = -10; z < 10; ++z) {
    const auto below = column(z), above = column(z + 1);
    if (below.known() && above.known() && below.distance_m() < 0 && above.distance_m() >= 0)
      return kVoxel_m * (z + static_cast<double>(below.distance_m()) /
                                 static_cast<double>(below.distance_m() - above.distance_m()));
  }
  return std::nan("");
}

TEST(FillGround, ClosesGapsUpToTheirSize) {
  TsdfVolume volume = volume_of([](double x, double y) {
    const bool small = std::abs(x - 2) < 1 && std::abs(y) < 1,
               large = std::abs(x - 8) < 2 && std::abs(y) < 2;
    return !small && !large;
  });
  ASSERT_TRUE(std::isnan(height(volume, 2, 0)));
  ASSERT_NEAR(height(volume, 5, 0), 0, 1e-3);
  const std::size_t filled = fill_ground(driven_line(), &volume);
  EXPECT_NEAR(static_cast<double>(filled), 500, 100) << "2 m x 2 m, and up to two voxels around it";
  for (double x = 1; x <= 3; x += 0.5)
    for (double y = -1; y <= 1; y += 0.5) EXPECT_NEAR(height(volume, x, y), 0, 0.1 * kVoxel_m);
  const auto point = volume.find({20, 0, 0});
  ASSERT_TRUE(point.known());
  EXPECT_NEAR(point.block->rgb[point.offset][1], 100, 1);
  EXPECT_TRUE(std::isnan(height(volume, 8, 0))) << "4 m wide";
  EXPECT_TRUE(std::isnan(height(volume, 5, 4.8))) << "nothing beyond the border";
}

TEST(FillGround, TakesNoRoofForTheGround) {
  // Half of the corridor is 1.5 m higher: the top of something that stands there.
  const auto images = [&](bool roof) {
    return see(
        [roof](const Eigen::Vector3d& origin,
               const Eigen::Vector3d& direction) -> std::optional<SurfaceHit> {
          const double top = roof ? 1.5 : 0;
          const double depth = (top - origin.z()) / direction.z();
          const Eigen::Vector3d at = origin + depth * direction;
          if (!(depth > 0) || (at.y() > 2) != roof) return std::nullopt;
          return SurfaceHit{depth, Eigen::Vector3d::UnitZ(), {}};
        },
        right_angle_camera(200), looking({5, 0, 6}, {0, 0, -1}));
  };
  ThreadPool pool(2);
  TsdfVolume volume(kVoxel_m, kAmpleMemory);
  volume.fuse(std::vector<DepthImage>{images(false), images(true)}, 20, pool);
  fill_ground(driven_line(), &volume);
  EXPECT_NEAR(height(volume, 5, 1), 0, 1e-3);
  EXPECT_TRUE(std::isnan(height(volume, 5, 4.4))) << "the closing ends at the roof's edge";
}

TEST(FillGround, ClosesAHoleThatImagesLookThrough) {
  // A puddle of 2 m x 2 m mirrors something 2 m above it.
  const Surface mirror = [](const Eigen::Vector3d& origin,
                            const Eigen::Vector3d& direction) -> std::optional<SurfaceHit> {
    const double depth = -origin.z() / direction.z();
    const Eigen::Vector3d at = origin + depth * direction;
    const bool puddle = std::abs(at.x() - 5) < 1 && std::abs(at.y()) < 1;
    return SurfaceHit{
        puddle ? depth * (origin.z() + 2) / origin.z() : depth, Eigen::Vector3d::UnitZ(), {}};
  };
  ThreadPool pool(2);
  TsdfVolume volume(kVoxel_m, kAmpleMemory);
  const auto camera = right_angle_camera(200);
  volume.fuse(std::vector<DepthImage>{see(mirror, camera, looking({5, 0, 6}, {0, 0, -1}))}, 20,
              pool);
  ASSERT_TRUE(std::isnan(height(volume, 5, 0)));
  fill_ground(driven_line(), &volume);
  EXPECT_NEAR(height(volume, 5, 0), 0, 0.1 * kVoxel_m);
}

TEST(FillGround, LeavesAVolumeWithoutGroundAlone) {
  TsdfVolume volume(kVoxel_m, kAmpleMemory);
  EXPECT_EQ(fill_ground(driven_line(), &volume), 0u);
  EXPECT_TRUE(volume.blocks().empty());
}

}  // namespace
}  // namespace redrive
