// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/initial_gaussians.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "redrive/methods/splat/gaussian_points.h"
#include "redrive/methods/splat/splat_scene_testing.h"
#include "redrive/scene/textured_drive_testing.h"

namespace redrive {
namespace {

constexpr float kWall_m = 10;

/// A car with a camera that looks ahead, at a wall across its way: red to the left of the middle,
/// blue to its right.
struct WallScene : SplatScene {
  WallScene() {
    const int front =
        add_camera("FRONT", "opencv_pinhole", {60, 60, 39.5, 29.5, 0, 0, 0, 0, 0}, 80, 60);
    rig(front).body_from_sensor.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    for (int n = 0; n < 4; ++n) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation() = Eigen::Vector3d(0.2 * n, 0, 1);
      add_view(front, pose, /*held_out=*/n == 1);
    }
    finish();
    for (std::size_t v = 0; v < images.size(); ++v) {
      if (scene.views[v].held_out) continue;
      for (int y = 0; y < 60; ++y)
        for (int x = 0; x < 80; ++x) {
          std::uint8_t* const pixel = &images[v].rgb[3 * (80 * y + x)];
          pixel[x < 40 ? 0 : 2] = 204;
          pixel[1] = 51;
        }
    }
  }
  /// Returns on a grid of the wall, from the middle of the first frame's body.
  void scan(float step = 0.1f, float lowest = -2, float highest = 4) {
    std::vector<MeasuredPoint> ends;
    for (float y = -4; y < 4; y += step)
      for (float z = lowest; z < highest; z += step)
        ends.push_back({{kWall_m, y, z}, scene.frames[0].t_ns});
    lidar = returns_of(scene, ends);
  }
  GaussianList gaussians(InitialGaussianOptions options, std::uint64_t seed = 1, int threads = 2) {
    options.tracks = false;
    ThreadPool pool(threads);
    return initial_gaussians(data(), options, seed, pool, &unseen);
  }
  std::size_t unseen = 0;
};

const float* row(const GaussianList& list, std::size_t i) { return &list.rows[i * kGaussianRows]; }
Eigen::Vector3f position(const GaussianList& list, std::size_t i) {
  return {row(list, i)[0], row(list, i)[1], row(list, i)[2]};
}
float scale(const GaussianList& list, std::size_t i, int k) {
  return std::exp(row(list, i)[kLogScaleRow + k]);
}
float opacity(const GaussianList& list, std::size_t i) {
  return 1 / (1 + std::exp(-row(list, i)[kOpacityRow]));
}

TEST(InitialGaussians, AWallGivesFlatDiscsWithItsColours) {
  WallScene wall;
  wall.scan();
  const GaussianList list = wall.gaussians({.sky = 0, .extruded = 0});
  // 80 x 60 returns 0.1 m apart, of which the voxels of 0.09 to 0.13 m merge some.
  EXPECT_GT(list.size(), 1500u);
  EXPECT_LE(list.size(), 4800u);
  for (std::size_t i = 0; i < list.size(); ++i) {
    const Eigen::Vector3f at = position(list, i);
    ASSERT_NEAR(at.x(), kWall_m, 1e-4);
    const float* const q = row(list, i) + kQuaternionRow;
    const Eigen::Matrix3f axes = Eigen::Quaternionf(q[0], q[1], q[2], q[3]).toRotationMatrix();
    ASSERT_NEAR(std::fabs(axes(0, 2)), 1, 1e-3) << "the last axis is the normal";
    ASSERT_LT(scale(list, i, 2), 0.2f * scale(list, i, 0));
    ASSERT_NEAR(scale(list, i, 0), scale(list, i, 1), 1e-6);
    // Half the distance to the neighbours, 0.1 m or what merged returns leave.
    ASSERT_GT(scale(list, i, 0), 0.02f);
    ASSERT_LT(scale(list, i, 0), 0.12f);
    if (std::fabs(at.y()) > 0.3f) {
      ASSERT_NEAR(row(list, i)[kColourRow + (at.y() > 0 ? 0 : 2)], 0.8f, 1e-3);
      ASSERT_NEAR(row(list, i)[kColourRow + (at.y() > 0 ? 2 : 0)], 0, 1e-3);
      ASSERT_NEAR(row(list, i)[kColourRow + 1], 0.2f, 1e-3);
    }
    for (int k = 0; k < 9; ++k) ASSERT_EQ(row(list, i)[kHarmonicsRow + k], 0);
    ASSERT_NEAR(row(list, i)[kDistanceRow], (at - Eigen::Vector3f(0.6f, 0, 1)).norm(), 1e-3);
  }
}

TEST(InitialGaussians, ReturnsThatNoImageSeesHaveIntensitiesAlone) {
  WallScene wall;
  std::vector<MeasuredPoint> ends;
  for (const float x : {kWall_m, -kWall_m})
    for (float y = -4; y < 4; y += 0.1f)
      for (float z = -2; z < 4; z += 0.1f) ends.push_back({{x, y, z}, wall.scene.frames[0].t_ns});
  wall.lidar = returns_of(wall.scene, ends);
  wall.lidar.intensity.assign(wall.lidar.n, 51);
  const std::size_t seen = wall.gaussians({.sky = 0, .extruded = 0}).size();
  EXPECT_EQ(wall.unseen, 0u) << "a cloud has no scans";
  wall.lidar.scan_ends = {{wall.lidar.n, 0, 0}};
  const GaussianList list = wall.gaussians({.max_gaussians = int(seen), .sky = 0, .extruded = 0});
  EXPECT_GT(wall.unseen, 1500u);
  EXPECT_GT(list.size(), wall.unseen + seen / 3) << "they are beyond max_gaussians";
  std::size_t behind = 0;
  for (std::size_t i = 0; i < list.size(); ++i) {
    EXPECT_NEAR(row(list, i)[kLidarRow + 2 * kIntensitySlot], 0.2, 1e-6);
    EXPECT_EQ(row(list, i)[kLidarRow + 2 * kReturnSlot], 1);
    behind += position(list, i).x() < 0;
  }
  EXPECT_EQ(behind, wall.unseen);
  wall.gaussians({.max_unseen = 500, .sky = 0, .extruded = 0});
  EXPECT_LE(wall.unseen, 500u);
  EXPECT_GT(wall.unseen, 100u);
}

TEST(InitialGaussians, HighReturnsAreExtrudedUpwards) {
  WallScene wall;
  wall.scan(0.05f, -2, 4);
  const std::size_t without = wall.gaussians({.voxel = 0.002f, .sky = 0, .extruded = 0}).size();
  const GaussianList list = wall.gaussians({.voxel = 0.002f, .sky = 0, .extruded = 0.5f});
  const std::size_t more = list.size() - without;
  // Returns between 1.5 and 4 m of 6 m, half of them.
  EXPECT_GT(more, without / 10);
  EXPECT_LT(more, without / 3);
  std::size_t faint = 0, above = 0;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const Eigen::Vector3f at = position(list, i);
    ASSERT_NEAR(at.x(), kWall_m, 1e-3);
    above += at.z() > 4;
    if (opacity(list, i) > 0.3f) continue;
    ++faint;
    EXPECT_GT(at.z(), 1.45f);
    EXPECT_LT(at.z(), 13);
  }
  EXPECT_EQ(faint, more);
  EXPECT_GT(above, more / 3);
}

TEST(InitialGaussians, TheSkyIsWhereAnImageSeesIt) {
  WallScene wall;
  wall.scan();
  const GaussianList without = wall.gaussians({.sky = 0}), list = wall.gaussians({.sky = 3000});
  ASSERT_GT(list.size(), without.size() + 50);
  // A camera of 67 x 53 degrees sees a tenth of the upper half.
  EXPECT_LT(list.size(), without.size() + 600);
  EXPECT_TRUE(std::ranges::equal(without.rows, std::span(list.rows).first(without.rows.size())));
  const Camera& camera = wall.scene.rig[0].camera;
  for (std::size_t i = without.size(); i < list.size(); ++i) {
    const Eigen::Vector3f at = position(list, i);
    EXPECT_GT((at - Eigen::Vector3f(0.3f, 0, 1)).norm(), 100) << "beyond the scene";
    const auto seen_from = [&](const View& view) {
      const auto pixel =
          camera.project(wall.scene.world_from_camera(view).inverse() * at.cast<double>());
      return pixel && pixel->x() > -0.5 && pixel->y() > -0.5 && pixel->x() < 79.5 &&
             pixel->y() < 59.5;
    };
    EXPECT_TRUE(std::ranges::any_of(
        wall.scene.views, [&](const View& view) { return !view.held_out && seen_from(view); }));
    if (std::fabs(at.y()) > 10) {
      EXPECT_NEAR(row(list, i)[kColourRow + (at.y() > 0 ? 0 : 2)], 0.8f, 1e-3);
    }
  }
  wall.scene.background = Background::kWhite;
  EXPECT_EQ(wall.gaussians({.sky = 3000}).rows, without.rows) << "a background needs no sky";
}

TEST(InitialGaussians, MaskedPixelsColourNothing) {
  WallScene wall;
  wall.scan();
  for (std::size_t v = 0; v < wall.images.size(); ++v) {
    if (wall.scene.views[v].held_out) continue;
    wall.images[v].used.assign(80 * 60, 1);
    for (int y = 0; y < 60; ++y) std::fill_n(&wall.images[v].used[80 * y], 30, 0);
  }
  const GaussianList list = wall.gaussians({.sky = 3000, .extruded = 0});
  EXPECT_GT(list.size(), 1000u);
  for (std::size_t i = 0; i < list.size(); ++i)
    EXPECT_LT(position(list, i).y() / position(list, i).x(), 0.25f)
        << "30 pixels of 60 focal lengths";
}

TEST(InitialGaussians, ABoundedSceneWithoutPointsStartsAtRandom) {
  WallScene wall;
  wall.scene.half_side = 1.5;
  wall.scene.metric = false;
  wall.scene.background = Background::kBlack;
  const GaussianList list = wall.gaussians({.random = 700});
  ASSERT_EQ(list.size(), 700u);
  const NearestCamera cameras(wall.scene);
  Eigen::Vector3f mean = Eigen::Vector3f::Zero(), most = mean;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const Eigen::Vector3f at = position(list, i);
    mean += at / 700;
    most = most.cwiseMax(at.cwiseAbs());
    EXPECT_FLOAT_EQ(row(list, i)[kDistanceRow], cameras.distance(at.data()));
    EXPECT_LT(opacity(list, i), 0.2f);
    for (int k = 0; k < 3; ++k) {
      EXPECT_GE(row(list, i)[kColourRow + k], 0);
      EXPECT_LT(row(list, i)[kColourRow + k], 1);
    }
  }
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(mean[k], 0, 5 * 1.5 / std::sqrt(3 * 700.0));
    EXPECT_LE(most[k], 1.5);
    EXPECT_GT(most[k], 1.4);
  }
  EXPECT_NE(wall.gaussians({.random = 700}, /*seed=*/2).rows, list.rows);
}

TEST(InitialGaussians, RandomOnesBeginInTheVisualHull) {
  WallScene wall;
  wall.scene.half_side = 4;
  wall.scene.metric = false;
  wall.scene.background = Background::kBlack;
  // Opaque is 40 x 30 pixels in the middle, with focal lengths of 60.
  for (Image8& image : wall.images) {
    if (image.rgb.empty()) continue;
    image.alpha.assign(image.rgb.size() / 3, 0);
    for (int y = 15; y < 45; ++y)
      for (int x = 20; x < 60; ++x) image.alpha[80 * y + x] = 255;
  }
  const GaussianList list = wall.gaussians({.random = 700});
  ASSERT_EQ(list.size(), 700u);
  for (std::size_t i = 0; i < list.size(); ++i) {
    const Eigen::Vector3f at = position(list, i);
    int seen = 0;
    for (const float camera : {0.0f, 0.4f, 0.6f}) {  // where the training images are
      const float depth = at.x() - camera, u = 60 * std::fabs(at.y()) / depth,
                  v = 60 * std::fabs(at.z() - 1) / depth;
      if (depth <= 0 || u > 39 || v > 29) continue;
      ++seen;
      EXPECT_TRUE(u < 21.5f && v < 16.5f) << at.transpose() << ": with one pixel around";
    }
    EXPECT_GT(seen, 0) << at.transpose();
  }
  for (Image8& image : wall.images) std::ranges::fill(image.alpha, 0);
  EXPECT_EQ(wall.gaussians({.random = 700}).size(), 700u) << "an empty hull tells nothing";
}

TEST(InitialGaussians, PointsOfTracksBeginTranslucentAndSmall) {
  const TemporaryFolder folder;
  SplatScene street;
  street.scene = make_scene(make_test_drive(folder.path, 8, /*textured=*/false), {});
  for (const View& view : street.scene.views)
    street.images.push_back(
        draw_street(street.rig(view.camera).camera, street.scene.shutter_poses(view)));
  street.pixels.emplace(street.scene, street.images, 1);
  ThreadPool pool(2);
  std::size_t unseen = 0;
  const GaussianList list = initial_gaussians(street.data(), {.sky = 0}, 1, pool, &unseen);
  ASSERT_GT(list.size(), 500u);
  std::vector<float> ratios;  // scale over the mean distance of the three nearest Gaussians
  for (std::size_t i = 0; i < list.size(); ++i) {
    ASSERT_NEAR(opacity(list, i), 0.1f, 1e-5);
    std::vector<float> distances;
    for (std::size_t k = 0; k < list.size(); ++k)
      if (k != i) distances.push_back((position(list, k) - position(list, i)).norm());
    std::partial_sort(distances.begin(), distances.begin() + 3, distances.end());
    ratios.push_back(scale(list, i, 0) * 3 / (distances[0] + distances[1] + distances[2]));
  }
  std::ranges::sort(ratios);
  EXPECT_NEAR(ratios[ratios.size() / 2], 0.3f, 1e-3) << "others are bounded by their distance";
}

TEST(InitialGaussians, AreNoMoreThanTheLimit) {
  WallScene wall;
  wall.scan();
  for (const int most : {100, 1000, 3000})
    for (const int sky : {0, 200, 100'000}) {
      const GaussianList list = wall.gaussians({.max_gaussians = most, .sky = sky});
      EXPECT_LE(list.size(), static_cast<std::size_t>(most)) << sky;
      EXPECT_GE(list.size(), static_cast<std::size_t>(most) / 2) << sky;
    }
}

TEST(InitialGaussians, ThreadsAndRerunsChangeNoBit) {
  WallScene wall;
  wall.scan();
  const InitialGaussianOptions options{.max_gaussians = 2000, .sky = 500, .extruded = 0.3f};
  const GaussianList one = wall.gaussians(options, 5, 1), four = wall.gaussians(options, 5, 4);
  EXPECT_EQ(one.rows, four.rows);
  EXPECT_NE(wall.gaussians(options, 6, 1).rows, one.rows) << "another choice";
}

}  // namespace
}  // namespace redrive
