// SPDX-License-Identifier: Apache-2.0
// Single rays through Gaussians: the depth of a wall of them, which follows from a formula, and
// rays beside the image of the same pixels.
#include "redrive/methods/splat/trace_gaussians.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/methods/splat/known_splats_testing.h"

namespace redrive::known_splats {
namespace {

using Eigen::Vector3d;

/// Flat, opaque Gaussians every 0.1 m on a plane.
GaussianList wall(const Vector3d& centre, const Eigen::Matrix3d& axes, int half_side) {
  const Eigen::Quaterniond turn(axes);  // the plane's normal is x
  GaussianList list;
  for (int j = -half_side; j <= half_side; ++j)
    for (int k = -half_side; k <= half_side; ++k) {
      const Vector3d at = centre + axes * Vector3d(0, 0.1 * j, 0.1 * k);
      std::array<float, kGaussianRows> rows{};
      for (int d = 0; d < 3; ++d) {
        rows[kPositionRow + d] = static_cast<float>(at[d]);
        rows[kLogScaleRow + d] = std::log(d == 0 ? 0.001f : 0.08f);
      }
      const double q[4] = {turn.w(), turn.x(), turn.y(), turn.z()};
      for (int d = 0; d < 4; ++d) rows[kQuaternionRow + d] = static_cast<float>(q[d]);
      rows[kOpacityRow] = 5;
      rows[kDistanceRow] = static_cast<float>(at.norm());
      list.rows.insert(list.rows.end(), rows.begin(), rows.end());
    }
  return list;
}

struct OwnRays {
  std::vector<Vector3d> origins, directions;
  std::vector<float> origin, direction;

  kernels::Rays view() {
    const std::size_t n = origins.size();
    origin.resize(3 * n);
    direction.resize(3 * n);
    for (std::size_t i = 0; i < n; ++i)
      for (int k = 0; k < 3; ++k) {
        origin[k * n + i] = static_cast<float>(origins[i][k]);
        direction[k * n + i] = static_cast<float>(directions[i][k]);
      }
    return {static_cast<int>(n), origin, direction};
  }
};

Eigen::Matrix3d turned(double yaw, double pitch) {
  return (Eigen::AngleAxisd(yaw, Vector3d::UnitZ()) * Eigen::AngleAxisd(pitch, Vector3d::UnitY()))
      .toRotationMatrix();
}

/// Sends rays from points of a drive to points of a wall and expects their exact ranges.
void expect_exact(const Vector3d& centre, const Eigen::Matrix3d& axes, double tolerance) {
  SplatModel model;
  set_gaussians(wall(centre, axes, 25), &model);
  OwnRays rays;
  std::vector<double> ranges;
  for (int i = 0; i < 400; ++i) {
    const Vector3d from(0.004 * i, 0.01 * std::sin(i), 0),
        to =
            centre + axes * Vector3d(0, signed_random(21, 2 * i), signed_random(21, 2 * i + 1)) * 2;
    rays.origins.push_back(from);
    rays.directions.push_back((to - from).normalized());
    ranges.push_back((to - from).norm());
  }
  const auto backend = fast_backend();
  const RenderedRays traced = model.trace(*backend, rays.view());
  ASSERT_EQ(traced.depth.size(), 400u);
  for (std::size_t i = 0; i < 400; ++i) {
    EXPECT_GT(traced.opacity[i], 0.9) << i;
    EXPECT_NEAR(traced.depth[i], ranges[i], tolerance * ranges[i]) << i;
  }
}

// The depth of a Gaussian within a pixel is its plane's to first order.
TEST(TraceGaussians, RangesOfAWallAreExact) {
  expect_exact({10, 0, 0}, Eigen::Matrix3d::Identity(), 1e-3);
}
TEST(TraceGaussians, RangesOfAWallInACornerOfTheCubeAreExact) {
  expect_exact({5, 5, 5}, turned(0.8, -0.6), 1e-3);
}
// A road, 1.8 m below the sensor and 3 to 8 m away.
TEST(TraceGaussians, RangesOfARoadAreExact) {
  expect_exact({5.5, 0, -1.8}, turned(0, 1.5707963), 5e-3);
}

TEST(TraceGaussians, RaysPastEverythingAreTransparent) {
  SplatModel model;
  set_gaussians(wall({10, 0, 0}, Eigen::Matrix3d::Identity(), 25), &model);
  OwnRays rays;
  for (const Vector3d& direction : {Vector3d(-1, 0, 0), Vector3d(0, 0, 1), Vector3d(1, 1, 1)}) {
    rays.origins.emplace_back(0, 0, 0);
    rays.directions.push_back(direction.normalized());
  }
  const RenderedRays traced = model.trace(*fast_backend(), rays.view());
  for (const float opacity : traced.opacity) EXPECT_LT(opacity, 1e-3);
}

TEST(TraceGaussians, AgreesWithTheImage) {
  const KnownScene known;
  const auto backend = fast_backend();
  const RayTable table = make_ray_table(known.scene.rig[0].camera);
  const Rigid3d pose = known.scene.world_from_camera(known.scene.views[0]);
  OwnRays rays;
  for (std::size_t k = 0; k < table.pixel.size(); ++k) {
    rays.origins.push_back(pose.translation());
    rays.directions.push_back(pose.linear() * Vector3d(table.direction[3 * k],
                                                       table.direction[3 * k + 1],
                                                       table.direction[3 * k + 2]));
  }
  const RenderedRays traced = known.truth.trace(*backend, rays.view());
  const RenderedImage image = known.render(*backend, known.truth, 0);
  int opaque = 0, same = 0;
  for (std::size_t k = 0; k < table.pixel.size(); ++k) {
    if (image.opacity[table.pixel[k]] < 0.8f || traced.opacity[k] < 0.8f) continue;
    ++opaque;
    same += std::abs(traced.depth[k] / image.depth[table.pixel[k]] - 1) < 0.02f;
  }
  EXPECT_GT(opaque, 300);
  EXPECT_GT(same, 0.9 * opaque) << "of " << opaque;
}

}  // namespace
}  // namespace redrive::known_splats
