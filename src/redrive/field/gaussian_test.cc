// SPDX-License-Identifier: Apache-2.0
// The projection of a Gaussian against integration over its density, and its adjoint against
// automatic differentiation.
#include "redrive/field/gaussian.h"

#include <array>
#include <cmath>
#include <random>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/camera/camera.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

constexpr int kVariables = kDistanceRow + 6;  // rows, then translation and rotation of the camera
using Jet = ceres::Jet<double, kVariables>;
using Numbers = NumberMath<double>;
using Jets = NumberMath<Jet>;

PlainCamera camera_of(const CameraModel& model, float max_radius2) {
  PlainCamera camera = make_plain_camera(Camera{model, 200, 190, 96, 52, 192, 104});
  camera.max_radius2 = max_radius2;
  return camera;
}
PlainCamera pinhole() {
  return camera_of(OpenCvPinhole(std::array{-0.2, 0.05, 0.001, -0.002, 0.0}), 1.2f);
}
PlainCamera fisheye() {
  return camera_of(Mei(std::array{-0.2, 0.05, 0.001, -0.002, 0.01, 1.4}), 0.9f);
}

SphericalCamera lidar() { return make_spherical_camera(500, 1.4, 192, 104); }

std::array<double, kDistanceRow> random_rows(std::mt19937* random, double log_scale) {
  std::uniform_real_distribution<double> uniform(-1, 1);
  std::array<double, kDistanceRow> rows;
  for (double& row : rows) row = uniform(*random);
  rows[kPositionRow + 2] += 4;
  for (int k = 0; k < 3; ++k) rows[kLogScaleRow + k] = log_scale + 0.7 * uniform(*random);
  // None is clamped.
  for (int k = 0; k < 3; ++k) rows[kColourRow + k] = 2 + uniform(*random);
  for (int slot = 0; slot < kLidarSlots; ++slot) rows[kLidarRow + 2 * slot] = 2 + uniform(*random);
  return rows;
}

GaussianPose<Numbers> some_pose() {
  const Eigen::Matrix3d r = so3_exp(Eigen::Vector3d(0.05, -0.1, 0.2));
  GaussianPose<Numbers> pose;
  for (int k = 0; k < 9; ++k) pose.rotation[k] = r(k / 3, k % 3);
  pose.centre[0] = 0.1;
  pose.centre[1] = -0.2;
  pose.centre[2] = 0.3;
  return pose;
}

/// A weighted sum of all that a projection yields.
template <class M>
typename M::Real weighted_sum(const ProjectedGaussian<M>& at) {
  using std::log;
  using T = typename M::Real;
  return T(0.3) * at.mean[0] - T(0.2) * at.mean[1] + T(7) * at.conic[0] + T(5) * at.conic[1] -
         T(3) * at.conic[2] + T(0.9) * log(at.alpha) + T(0.4) * at.colour[0] -
         T(0.6) * at.colour[1] + T(0.8) * at.colour[2] + T(0.11) * at.length;
}
const ProjectedGradient<Numbers> kWeights{{0.3, -0.2}, {7, 5, -3}, 0.9, {0.4, -0.6, 0.8}, 0.11};

template <class C>
void expect_adjoint(const C& camera, double log_scale, unsigned seed) {
  std::mt19937 random(seed);
  for (int trial = 0; trial < 20; ++trial) {
    const std::array<double, kDistanceRow> rows = random_rows(&random, log_scale);
    const GaussianPose<Numbers> pose = some_pose();
    ProjectedGaussian<Numbers> at;
    project_mean<Numbers>(camera, pose, rows.data(), &at);
    ASSERT_TRUE(at.visible);
    project_gaussian<Numbers>(camera, pose, rows.data(), &at);
    double d_rows[kGaussianRows];
    GaussianPoseGradient<Numbers> d_pose;
    project_gaussian_adjoint<Numbers>(camera, pose, rows.data(), at, kWeights, d_rows, &d_pose);

    std::array<Jet, kDistanceRow> variables;
    for (int row = 0; row < kDistanceRow; ++row) variables[row] = Jet(rows[row], row);
    // The camera translates by v and rotates by w in the world: R exp(-[w]), centre + v.
    GaussianPose<Jets> moved;
    Jet w[3];
    for (int k = 0; k < 3; ++k) {
      moved.centre[k] = Jet(pose.centre[k], kDistanceRow + k);
      w[k] = Jet(0, kDistanceRow + 3 + k);
    }
    const Jet turned[3][3] = {{Jet(1), w[2], -w[1]}, {-w[2], Jet(1), w[0]}, {w[1], -w[0], Jet(1)}};
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) {
        moved.rotation[3 * r + c] = Jet(0);
        for (int k = 0; k < 3; ++k)
          moved.rotation[3 * r + c] += Jet(pose.rotation[3 * r + k]) * turned[k][c];
      }
    ProjectedGaussian<Jets> jets;
    project_mean<Jets>(camera, moved, variables.data(), &jets);
    project_gaussian<Jets>(camera, moved, variables.data(), &jets);
    const Jet sum = weighted_sum(jets);
    EXPECT_NEAR(sum.a, weighted_sum(at), 1e-9 * std::abs(sum.a));
    const double scale = sum.v.norm();
    for (int row = 0; row < kDistanceRow; ++row)
      EXPECT_NEAR(is_seen(kSeenBy<C>, row) ? d_rows[row] : 0, sum.v[row], 1e-9 * scale)
          << "row " << row;
    for (int k = 0; k < 3; ++k) {
      EXPECT_NEAR(d_pose.translation[k], sum.v[kDistanceRow + k], 1e-9 * scale);
      EXPECT_NEAR(d_pose.rotation[k], sum.v[kDistanceRow + 3 + k], 1e-9 * scale);
    }
  }
}

TEST(GaussianTest, AdjointOfAPinhole) { expect_adjoint(pinhole(), -2, 1); }
TEST(GaussianTest, AdjointOfAFisheye) { expect_adjoint(fisheye(), -2, 2); }
TEST(GaussianTest, AdjointOfEveryModel) {
  for (const CameraModelInfo& model : camera_models()) {
    SCOPED_TRACE(model.name);
    expect_adjoint(camera_of(model.make(model.typical), 1.2f), -2, 4);
  }
}
TEST(GaussianTest, AdjointOfALidar) { expect_adjoint(lidar(), -2, 6); }
TEST(GaussianTest, AdjointOfLargeGaussians) { expect_adjoint(fisheye(), 1.2, 3); }

TEST(GaussianTest, AColourBelowZeroMayRiseButNotFall) {
  std::mt19937 random(7);
  std::array<double, kDistanceRow> rows = random_rows(&random, -2);
  for (int k = 0; k < 3; ++k) rows[kColourRow + k] = -5;
  const GaussianPose<Numbers> pose = some_pose();
  ProjectedGaussian<Numbers> at;
  project_mean<Numbers>(pinhole(), pose, rows.data(), &at);
  ASSERT_TRUE(at.visible);
  project_gaussian<Numbers>(pinhole(), pose, rows.data(), &at);
  ProjectedGradient<Numbers> gradient{{0, 0}, {0, 0, 0}, 0, {-0.5, 0.25, 0}, 0};
  double d_rows[kGaussianRows];
  GaussianPoseGradient<Numbers> d_pose;
  project_gaussian_adjoint<Numbers>(pinhole(), pose, rows.data(), at, gradient, d_rows, &d_pose);
  for (int k = 0; k < 3; ++k) {
    EXPECT_EQ(d_rows[kColourRow + k], k == 0 ? -0.5 : 0);
    for (int c = 0; c < 3; ++c)
      EXPECT_EQ(d_rows[kHarmonicsRow + 3 * k + c], c == 0 ? -0.5 * at.direction[k] : 0);
    EXPECT_EQ(d_rows[kPositionRow + k], 0);  // a clamped colour changes no pixel
    EXPECT_EQ(d_pose.translation[k], 0);
  }
}

/// Mean and covariance of the image of a Gaussian, from a grid of its density.
template <class C>
void expect_covariance(const C& camera) {
  std::mt19937 random(4);
  for (int trial = 0; trial < 5; ++trial) {
    const std::array<double, kDistanceRow> rows = random_rows(&random, -3);
    const GaussianPose<Numbers> pose = some_pose();
    ProjectedGaussian<Numbers> at;
    project_mean<Numbers>(camera, pose, rows.data(), &at);
    project_gaussian<Numbers>(camera, pose, rows.data(), &at);
    double sum = 0, xx = 0, xy = 0, yy = 0;
    constexpr int kSteps = 12;
    for (int i = -kSteps; i <= kSteps; ++i)
      for (int j = -kSteps; j <= kSteps; ++j)
        for (int k = -kSteps; k <= kSteps; ++k) {
          const double s[3] = {4.0 * i / kSteps, 4.0 * j / kSteps, 4.0 * k / kSteps};
          double p[3] = {at.point[0], at.point[1], at.point[2]};
          for (int axis = 0; axis < 3; ++axis)
            for (int r = 0; r < 3; ++r) p[r] += s[axis] * at.scale[axis] * at.axis[axis][r];
          const PlainPixel<Numbers> pixel = project<Numbers>(camera, p[0], p[1], p[2]);
          const double weight = std::exp(-0.5 * (s[0] * s[0] + s[1] * s[1] + s[2] * s[2]));
          const double u = pixel.u - at.mean[0], v = pixel.v - at.mean[1];
          sum += weight;
          xx += weight * u * u;
          xy += weight * u * v;
          yy += weight * v * v;
        }
    EXPECT_NEAR(at.variance[0] - double(kScreenVariance), xx / sum, 0.02 * xx / sum);
    EXPECT_NEAR(at.variance[1] - double(kScreenVariance), yy / sum, 0.02 * yy / sum);
    EXPECT_NEAR(at.covariance, xy / sum, 0.02 * std::sqrt(xx * yy) / sum);
  }
}
TEST(GaussianTest, CovarianceAgreesWithIntegrationThroughTheCamera) {
  expect_covariance(pinhole());
  expect_covariance(fisheye());
  expect_covariance(lidar());
}

TEST(GaussianTest, FilterKeepsTheSumOverThePixels) {
  std::mt19937 random(5);
  std::array<double, kDistanceRow> rows = random_rows(&random, -6);
  const GaussianPose<Numbers> pose = some_pose();
  ProjectedGaussian<Numbers> at;
  project_mean<Numbers>(pinhole(), pose, rows.data(), &at);
  project_gaussian<Numbers>(pinhole(), pose, rows.data(), &at);
  EXPECT_NEAR(at.alpha * std::sqrt(at.filtered_det), at.opacity * std::sqrt(at.det),
              1e-9 * at.opacity);
}

TEST(GaussianTest, BehindTheCameraOrBeyondTheFoldIsInvisible) {
  const GaussianPose<Numbers> pose{{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};
  const auto visible = [&](const PlainCamera& camera, double x, double z) {
    const double position[3] = {x, 0, z};
    ProjectedGaussian<Numbers> at;
    project_mean<Numbers>(camera, pose, position, &at);
    return at.visible;
  };
  EXPECT_TRUE(visible(pinhole(), 0, 1));
  EXPECT_FALSE(visible(pinhole(), 0, -1));
  EXPECT_FALSE(visible(pinhole(), 0, 0.1)) << "before the near plane";
  EXPECT_FALSE(visible(pinhole(), 2, 1)) << "beyond max_radius2";
  EXPECT_TRUE(visible(fisheye(), 2, 0.1));
  EXPECT_FALSE(visible(fisheye(), 0.3, -1));
}

}  // namespace
}  // namespace redrive
