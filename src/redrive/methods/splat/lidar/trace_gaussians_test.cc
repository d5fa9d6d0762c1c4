// SPDX-License-Identifier: Apache-2.0
// Single rays through Gaussians: the depth of a wall of them, which follows from a formula, and
// rays beside the image of the same pixels.
#include "redrive/methods/splat/lidar/trace_gaussians.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/methods/splat/known_splats_testing.h"
#include "redrive/methods/splat/own_rays_testing.h"

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
TEST(TraceGaussians, RangesOfAWallHighToTheSideAreExact) {
  expect_exact({5, 5, 5}, turned(0.8, -0.6), 2e-3);
}
TEST(TraceGaussians, RangesOfAWallAboveAreExact) {
  expect_exact({1, -2, 9}, turned(0, 1.5707963), 1e-3);
}
// A road, 1.8 m below the sensor and 3 to 8 m away.
TEST(TraceGaussians, RangesOfARoadAreExact) {
  expect_exact({5.5, 0, -1.8}, turned(0, 1.5707963), 5e-3);
}

/// Beams of a revolution between two walls, from a sensor that moves by `motion_m`.
struct Turn {
  static constexpr double kSide_m = 8;
  SplatModel model;
  OwnRays rays;
  std::vector<double> ranges;

  explicit Turn(const Vector3d& motion_m) {
    GaussianList walls = wall({0, kSide_m, 0}, turned(1.5707963, 0), 60);
    const GaussianList other = wall({0, -kSide_m, 0}, turned(1.5707963, 0), 60);
    walls.rows.insert(walls.rows.end(), other.rows.begin(), other.rows.end());
    set_gaussians(walls, &model);
    for (int step = 0; step < 360; ++step)
      for (int beam = -5; beam <= 5; ++beam) {
        const double part = (step + 0.5) / 360, azimuth = 3.14159265 * (1 - 2 * part),
                     elevation = 0.03 * beam;
        const Vector3d from = (part - 0.5) * motion_m,
                       to(std::cos(elevation) * std::cos(azimuth),
                          std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
        rays.origins.push_back(from);
        rays.directions.push_back(to);
        const double range = ((to.y() > 0 ? kSide_m : -kSide_m) - from.y()) / to.y();
        const Vector3d hit = from + range * to;
        const bool met = std::abs(hit.x()) < 5 && std::abs(hit.z()) < 5;
        ranges.push_back(met ? range : 0);
      }
  }
};

// Half a metre to the side during the turn: no ray's origin is another's.
TEST(TraceGaussians, RangesFromASensorThatMovesWhileItTurnsAreExact) {
  Turn turn({1.2, 0.5, 0});
  const RenderedRays traced = turn.model.trace(*fast_backend(), turn.rays.view());
  int met = 0;
  for (std::size_t i = 0; i < turn.ranges.size(); ++i) {
    if (turn.ranges[i] == 0) continue;
    ++met;
    EXPECT_GT(traced.opacity[i], 0.9) << i;
    EXPECT_NEAR(traced.depth[i], turn.ranges[i], 1e-3 * turn.ranges[i]) << i;
  }
  EXPECT_GT(met, 1000);
}

TEST(TraceGaussians, ThreadsChangeNoBit) {
  Turn turn({1.2, 0.5, 0});
  const RenderedRays one = turn.model.trace(*fast_backend(1), turn.rays.view()),
                     three = turn.model.trace(*fast_backend(3), turn.rays.view());
  EXPECT_EQ(one.depth, three.depth);
  EXPECT_EQ(one.opacity, three.opacity);
}

// A beam of 3 mrad is 3 cm wide at 10 m, and a thread of 1 mm covers a small part of it.
TEST(TraceGaussians, ANarrowGaussianCoversAPartOfTheBeam) {
  GaussianList thread;
  std::array<float, kGaussianRows> rows{};
  rows[kPositionRow] = 10;
  for (int k = 0; k < 3; ++k) rows[kLogScaleRow + k] = std::log(k == 2 ? 1.0f : 0.0005f);
  rows[kQuaternionRow] = 1;
  rows[kOpacityRow] = 8;
  thread.rows.assign(rows.begin(), rows.end());
  SplatModel model;
  set_gaussians(thread, &model);
  OwnRays rays;
  rays.origins.emplace_back(0, 0, 0);
  rays.directions.emplace_back(1, 0, 0);
  const auto backend = fast_backend();
  const auto opacity = [&](double beam_rad) {
    return trace_gaussians(
               backend->gaussians(), backend->pool(), rays.view(),
               [&](const RayRaster&) { return DrawnGaussians{model.world().gaussians}; }, beam_rad)
        .opacity[0];
  };
  // sigma: 0.05 mrad of the thread, a quarter of the width of the beam.
  for (const double beam_rad : {0.3e-3, 3e-3})
    EXPECT_NEAR(opacity(beam_rad), 0.05 / std::hypot(0.05, 250 * beam_rad), 0.01) << beam_rad;
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
