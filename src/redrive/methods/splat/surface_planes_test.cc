// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/surface_planes.h"

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/methods/splat/known_splats_testing.h"
#include "redrive/methods/splat/splat_scene_testing.h"

namespace redrive {
namespace {

/// A camera 1.5 m above a road, z = 0, and returns on it: every 10 cm of 8 x 8 m.
struct Road {
  SplatScene scene;
  Road() {
    const int camera =
        scene.add_camera("F", "opencv_pinhole", {100, 100, 50, 50, 0, 0, 0, 0, 0}, 101, 101);
    scene.add_view(camera, Rigid3d(Eigen::Translation3d(0, 0, 1.5)));
    scene.finish();
    for (int i = 0; i < 80; ++i)
      for (int k = 0; k < 80; ++k)
        add({0.1f * static_cast<float>(i) - 4, 0.1f * static_cast<float>(k) - 4, 0});
  }
  void add(const Eigen::Vector3f& at) { ends.push_back(at); }
  /// Rays from 1.7 m above the origin.
  LidarReturns returns() const {
    std::vector<MeasuredPoint> points;
    for (const Eigen::Vector3f& end : ends) points.push_back({end.cast<double>()});
    return returns_of(scene.scene, points, {0, 0, 0.2});
  }
  SurfacePlanes planes(int threads = 1) const {
    ThreadPool pool(threads);
    return SurfacePlanes(scene.scene, returns(), pool);
  }
  std::vector<Eigen::Vector3f> ends;
};

TEST(SurfacePlanes, LieOnTheReturns) {
  Road road;
  for (Eigen::Vector3f& end : road.ends) end.z() = 0.1f * end.x();  // rises by a tenth
  const SurfacePlanes planes = road.planes();
  const Eigen::Vector3f up = Eigen::Vector3f(-0.1f, 0, 1).normalized();
  for (const float height : {-0.08f, 0.0f, 0.08f}) {
    const SurfacePlane* plane = planes.at({2, 1, 0.2f + height}, 3);
    ASSERT_TRUE(plane);
    EXPECT_NEAR(std::fabs(plane->normal.dot(up)), 1, 1e-5);
    EXPECT_NEAR(plane->normal.dot(plane->mean), 0, 1e-3);
  }
  EXPECT_FALSE(planes.at({2, 1, 0.35f}, 3));
  EXPECT_TRUE(planes.at({2, 1, 0.35f}, 20)) << "farther away less exact";
  EXPECT_FALSE(planes.at({6, 1, 0.6f}, 3)) << "beside the returns";
}

TEST(SurfacePlanes, FlattenGaussiansWhereTheMethodPreparedThem) {
  Road road;
  road.scene.lidar = road.returns();
  road.scene.scene.metric = true;
  GaussianList list;
  list.rows.assign(kGaussianRows, 0);
  list.rows[kPositionRow + 2] = 0.05f;
  list.rows[kQuaternionRow] = list.rows[kDistanceRow] = 1;
  const auto backend = known_splats::fast_backend();
  const auto height_after = [&](std::int64_t step, bool prepared) {
    SplatModel model;
    model.set_gaussians({list}, {});
    StepBuffers buffers;
    if (prepared) model.prepare(road.scene.data(), backend->pool(), &buffers);
    AdamState adam = model.zero_moments();
    model.finish_step(*backend, {}, {}, step, buffers, &adam);
    return model.parameters[gaussian_slot(0, kPositionRow + 2)];
  };
  EXPECT_NEAR(height_after(50, true), 0.025f, 1e-4f) << "half of the way, surface_rate";
  EXPECT_EQ(height_after(49, true), 0.05f) << "every 50 steps";
  EXPECT_EQ(height_after(50, false), 0.05f);
}

TEST(SurfacePlanes, AreNotWhereSurfacesMeet) {
  Road road;  // a kerb along y = 0, 15 cm high
  for (Eigen::Vector3f& end : road.ends)
    if (end.y() > 0) end.z() = 0.15f;
  const SurfacePlanes planes = road.planes();
  EXPECT_FALSE(planes.at({2, 0.02f, 0.1f}, 3));
  EXPECT_FALSE(planes.at({2, -0.02f, 0.05f}, 3));
  EXPECT_TRUE(planes.at({2, 1, 0.15f}, 3));
  EXPECT_TRUE(planes.at({2, -1, 0}, 3));
}

TEST(SurfacePlanes, AreNotInFoliage) {
  Road road;
  for (std::size_t i = 0; i < road.ends.size(); ++i)
    road.ends[i].z() = 0.5f * random_unit(random_key(1, kStreamInit), i);
  const SurfacePlanes planes = road.planes();
  int found = 0;
  for (int i = 0; i < 60; ++i)
    found += planes.at({0.1f * static_cast<float>(i) - 3, 0.5f, 0.25f}, 3) != nullptr;
  EXPECT_LE(found, 3);
}

TEST(SurfacePlanes, AreNoneOfFewReturns) {
  Road road;
  road.ends.resize(5);
  EXPECT_FALSE(road.planes().at(road.ends[2], 3));
  road.ends.clear();
  EXPECT_FALSE(road.planes().at({0, 0, 0}, 3));
}

/// Gaussians of one block.
struct Block {
  std::vector<float> numbers = std::vector<float>(kBlockSize);
  float& at(std::size_t i, int row) { return numbers[gaussian_slot(i, row)]; }
  void set(std::size_t i, const Eigen::Vector3f& position, const Eigen::Vector3f& scale,
           const Eigen::Quaternionf& rotation, float distance) {
    for (int k = 0; k < 3; ++k) {
      at(i, kPositionRow + k) = position[k];
      at(i, kLogScaleRow + k) = std::log(scale[k]);
    }
    at(i, kQuaternionRow) = rotation.w();
    at(i, kQuaternionRow + 1) = rotation.x();
    at(i, kQuaternionRow + 2) = rotation.y();
    at(i, kQuaternionRow + 3) = rotation.z();
    at(i, kDistanceRow) = distance;
  }
  Eigen::Vector3d position(std::size_t i) {
    return {at(i, kPositionRow), at(i, kPositionRow + 1), at(i, kPositionRow + 2)};
  }
  Eigen::Matrix3d covariance(std::size_t i) {
    const Eigen::Quaterniond q(at(i, kQuaternionRow), at(i, kQuaternionRow + 1),
                               at(i, kQuaternionRow + 2), at(i, kQuaternionRow + 3));
    const Eigen::Matrix3d r = q.normalized().toRotationMatrix();
    Eigen::Vector3d variance;
    for (int k = 0; k < 3; ++k) variance[k] = std::exp(2.0 * double(at(i, kLogScaleRow + k)));
    return r * variance.asDiagonal() * r.transpose();
  }
};

TEST(FlattenGaussians, FollowsItsFormula) {
  const SurfacePlanes planes = Road().planes();
  ThreadPool pool(1);
  Block block;
  const Eigen::Matrix3d half = Eigen::Vector3d(1, 1, 0.5).asDiagonal();
  for (std::size_t i = 0; i < kGaussianBlock; ++i) {
    const auto random = [&](std::size_t k) {
      return random_unit(random_key(7, kStreamInit), 16 * i + k);
    };
    const Eigen::Quaternionf turn(random(0) - 0.5f, random(1) - 0.5f, random(2) - 0.5f,
                                  random(3) - 0.5f);
    block.set(i, {4 * random(4) - 2, 4 * random(5) - 2, 0.15f * random(6) - 0.075f},
              {0.02f + 0.1f * random(7), 0.02f + 0.1f * random(8), 0.02f + 0.1f * random(9)},
              Eigen::Quaternionf(turn.coeffs() * (0.5f + random(10)) / turn.norm()), 3);
  }
  Block after = block;
  flatten_gaussians(planes, 0.5f, kGaussianBlock, after.numbers.data(), pool);
  for (std::size_t i = 0; i < kGaussianBlock; ++i) {
    const Eigen::Vector3d at = after.position(i);
    EXPECT_TRUE(at.isApprox(half * block.position(i), 1e-4)) << i;
    const Eigen::Matrix3d expected = half * block.covariance(i) * half;
    EXPECT_TRUE(after.covariance(i).isApprox(expected, 1e-5)) << i;
    // The quaternion keeps its length.
    float length = 0, before = 0;
    for (int k = kQuaternionRow; k < kOpacityRow; ++k) {
      length += after.at(i, k) * after.at(i, k);
      before += block.at(i, k) * block.at(i, k);
    }
    EXPECT_NEAR(length, before, 1e-5f) << i;
  }
}

TEST(FlattenGaussians, EndsWithDiscsInThePlane) {
  const SurfacePlanes planes = Road().planes();
  ThreadPool pool(1);
  Block block;
  // A spike that leans by 45 degrees, a sphere, a disc across, one out of the plane's reach.
  const Eigen::Quaternionf leaning(Eigen::AngleAxisf(float(M_PI / 4), Eigen::Vector3f::UnitX()));
  block.set(0, {1, 1, 0.05f}, {0.004f, 0.004f, 0.1f}, leaning, 3);
  block.set(1, {-1, 1, -0.05f}, {0.05f, 0.05f, 0.05f}, leaning, 3);
  block.set(2, {-1, -1, 0.02f}, {0.0003f, 0.05f, 0.05f}, Eigen::Quaternionf::Identity(), 3);
  block.set(3, {1, -1, 0.5f}, {0.004f, 0.004f, 0.1f}, leaning, 3);
  const Block first = block;
  for (int n = 0; n < 30; ++n) flatten_gaussians(planes, 0.5f, 4, block.numbers.data(), pool);
  const double least = 3e-4;
  const auto flat = [&](double across, double along) {
    return Eigen::Vector3d(across * across, along * along, least * least);
  };
  const auto near = [&](std::size_t i, const Eigen::Vector3d& variances) {
    EXPECT_NEAR(block.position(i).z(), 0, 1e-4) << i;
    const Eigen::Matrix3d error = block.covariance(i) - Eigen::Matrix3d(variances.asDiagonal());
    // A disc may lean as far as it stays that thin.
    EXPECT_LT(error.norm(), 1.5 * least * std::sqrt(variances.maxCoeff())) << i;
    EXPECT_NEAR(std::sqrt(block.covariance(i)(2, 2)), least, 0.1 * least) << i;
  };
  near(0, flat(0.004, std::sqrt((0.1 * 0.1 + 0.004 * 0.004) / 2)));
  near(1, flat(0.05, 0.05));
  near(2, flat(0.0003, 0.05));
  for (int row = 0; row < kGaussianRows; ++row)
    EXPECT_EQ(block.at(3, row), first.numbers[gaussian_slot(3, row)]) << row;
  // A further call leaves a flat Gaussian as it is.
  Block again = block;
  flatten_gaussians(planes, 0.5f, 4, again.numbers.data(), pool);
  for (int row = kLogScaleRow; row < kGaussianRows; ++row)
    EXPECT_NEAR(again.at(1, row), block.at(1, row), 0.05f) << row;
}

// Adam's moments are by axis.
TEST(FlattenGaussians, KeepsTheOrderOfAxes) {
  const SurfacePlanes planes = Road().planes();
  ThreadPool pool(1);
  const Eigen::Vector3f sizes[] = {
      {0.02f, 0.05f, 0.1f}, {0.1f, 0.02f, 0.05f}, {0.05f, 0.1f, 0.02f}};
  for (const Eigen::Vector3f& size : sizes) {
    Block block;
    const Eigen::Quaternionf turn(Eigen::AngleAxisf(0.3f, Eigen::Vector3f(1, 2, 3).normalized()));
    block.set(0, {1, 1, 0.01f}, size, turn, 3);
    flatten_gaussians(planes, 0.2f, 1, block.numbers.data(), pool);
    const Eigen::Quaternionf turned(block.at(0, kQuaternionRow), block.at(0, kQuaternionRow + 1),
                                    block.at(0, kQuaternionRow + 2),
                                    block.at(0, kQuaternionRow + 3));
    // Each axis is the one before, turned by a few degrees.
    const Eigen::Matrix3f overlap = turn.toRotationMatrix().transpose() * turned.toRotationMatrix();
    for (int k = 0; k < 3; ++k) {
      EXPECT_GT(overlap(k, k), 0.9f) << k;
      EXPECT_NEAR(std::exp(block.at(0, kLogScaleRow + k)), size[k], 0.25f * size[k]) << k;
    }
  }
}

TEST(FlattenGaussians, DoesNotDependOnTheNumberOfThreads) {
  const Road road;
  std::vector<float> made[2];
  for (const int threads : {1, 3}) {
    const SurfacePlanes planes = road.planes(threads);
    ThreadPool pool(threads);
    constexpr std::size_t kGaussians = 10'000;
    std::vector<float>& numbers = made[threads / 3];
    numbers.assign(gaussian_blocks(kGaussians) * kBlockSize, 0);
    for (std::size_t i = 0; i < kGaussians; ++i) {
      for (int row = 0; row < kGaussianRows; ++row)
        numbers[gaussian_slot(i, row)] =
            random_unit(random_key(3, kStreamInit), kGaussianRows * i + row);
      numbers[gaussian_slot(i, kPositionRow + 2)] *= 0.1f;
    }
    flatten_gaussians(planes, 0.5f, kGaussians, numbers.data(), pool);
  }
  EXPECT_EQ(made[0], made[1]);
}

}  // namespace
}  // namespace redrive
