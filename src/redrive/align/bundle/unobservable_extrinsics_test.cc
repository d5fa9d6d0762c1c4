// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/unobservable_extrinsics.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/align/bundle/synthetic_rig_testing.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

const Vector6d kPrior = BundlePriors().extrinsics;  // 1 cm, 0.5 mrad

/// A rig at constant velocity, whose covariance has the given sigmas in body axes.
struct Rig {
  RigModel model;
  BundleResult result;

  Rig(std::vector<int> cameras, const std::vector<Vector6d>& sigmas) {
    testing::SyntheticOptions options;
    options.points = options.lidar_points = 0;
    options.pose_noise_m = options.pose_noise_rad = 0;
    options.straight = true;
    options.cameras = std::move(cameras);
    model = make_rig_model(testing::make_synthetic_rig(options).recording);
    const auto frames = static_cast<Eigen::Index>(6 * model.initial_frames.size());
    const auto n = frames + static_cast<Eigen::Index>(6 * model.cameras.size());
    result.covariance = Eigen::MatrixXd::Identity(n, n);
    for (std::size_t c = 0; c < sigmas.size(); ++c) {
      Eigen::Matrix<double, 6, 6> from_sensor;
      for (int axis = 0; axis < 6; ++axis)
        from_sensor.row(axis) = body_axis_of_extrinsics(model.cameras[c], axis);
      result.covariance.block<6, 6>(frames + 6 * static_cast<Eigen::Index>(c),
                                    frames + 6 * static_cast<Eigen::Index>(c)) =
          from_sensor.transpose() * sigmas[c].cwiseAbs2().asDiagonal() * from_sensor;
      result.ties_of_camera.push_back(1000);
    }
    result.robust_covariance = result.covariance;
  }
  std::vector<int> unobservable_axes(int camera) const {
    std::vector<int> axes;
    for (const UnobservableExtrinsic& number : unobservable_extrinsics(
             model, result, std::vector<int>(model.cameras.size(), 100), kPrior))
      if (number.camera == camera) axes.push_back(number.axis);
    return axes;
  }
};

Vector6d sigmas(double m, double rad) { return (Vector6d() << m, m, m, rad, rad, rad).finished(); }

// Rotations of the calibration about the body's axes, as poses are corrected: roll lowers the right
// side, pitch the front, yaw turns to the left.
TEST(UnobservableExtrinsics, RollPitchAndYawAreAboutTheBodysAxes) {
  Rig rig({1}, {sigmas(0, 0)});
  RigModelCamera& camera = rig.model.cameras[0];
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d turn = 0.01 * Eigen::Vector3d::Unit(axis),
                          moved = 0.02 * Eigen::Vector3d::Unit(axis);
    const Eigen::Matrix3d initial = camera.initial.body_from_sensor.linear();
    camera.extrinsics << initial.transpose() * moved,
        so3_log(initial.transpose() * so3_exp(turn) * initial);
    const Rigid3d now = rig.model.body_from_sensor(0);
    EXPECT_LT((now.linear() - so3_exp(turn) * initial).norm(), 1e-12);
    EXPECT_LT((now.translation() - camera.initial.body_from_sensor.translation() - moved).norm(),
              1e-12);
    Vector6d expected;
    expected << moved, turn;
    EXPECT_LT((extrinsics_in_body(camera) - expected).norm(), 1e-12);
    reset_extrinsic(&camera, axis);
    reset_extrinsic(&camera, axis + 3);
    EXPECT_LT(camera.extrinsics.norm(), 1e-12);
  }
  EXPECT_STREQ(extrinsic_name(3), "roll");
  EXPECT_STREQ(extrinsic_name(5), "yaw");
}

// Half of the prior's sigma is 0.25 mrad or 5 mm. Ties leave errors of 0.013 degrees, 0.227 mrad,
// and of 4 mm, beside which 0.105 mrad and 3 mm are left.
TEST(UnobservableExtrinsics, HaveNearlyThePriorsSigma) {
  EXPECT_THAT(Rig({0}, {sigmas(0.0029, 0.0001)}).unobservable_axes(0), IsEmpty());
  EXPECT_THAT(Rig({0}, {sigmas(0.0031, 0.0001)}).unobservable_axes(0), ElementsAre(0, 1, 2));
  EXPECT_THAT(Rig({0}, {sigmas(0.0029, 0.0004)}).unobservable_axes(0), ElementsAre(3, 4, 5));
  Rig knocked({0}, {sigmas(0.0029, 0.0004)});
  RigModelCamera& camera = knocked.model.cameras[0];
  camera.extrinsics = 0.0015 * body_axis_of_extrinsics(camera, 5);
  EXPECT_THAT(knocked.unobservable_axes(0), ElementsAre(3, 4)) << "yaw differs by three sigmas";
}

// At constant velocity nothing but ties to the LiDAR's surfaces determines roll and position,
// however small the residuals; the direction of the motion determines pitch and yaw to 2 mm over 6
// m.
TEST(UnobservableExtrinsics, WithoutTiesRollIsUnobservableAtConstantVelocity) {
  Rig rig({0}, {sigmas(1e-4, 1e-5)});
  EXPECT_THAT(rig.unobservable_axes(0), IsEmpty());
  rig.result.ties_of_camera[0] = 10;
  RigModelCamera& camera = rig.model.cameras[0];
  camera.extrinsics = 0.02 * body_axis_of_extrinsics(camera, 0);
  for (const int axis : {3, 4, 5})
    camera.extrinsics += 0.02 * body_axis_of_extrinsics(camera, axis);
  EXPECT_THAT(rig.unobservable_axes(0), ElementsAre(0, 1, 2, 3));
  EXPECT_LT(model_error(rig.model, 5, 0), 0.00035);
  EXPECT_GT(model_error(rig.model, 3, 0), 1);
}

// Each camera's own roll has the sigma of the prior, but the difference is known.
TEST(UnobservableExtrinsics, AreObservableAgainstOtherCameras) {
  Rig rig({0, 1}, {sigmas(1e-4, 0.0005), sigmas(1e-4, 0.0005)});
  EXPECT_THAT(rig.unobservable_axes(0), ElementsAre(3, 4, 5));
  const auto at = static_cast<Eigen::Index>(6 * rig.model.initial_frames.size());
  Eigen::MatrixXd to_body = Eigen::MatrixXd::Zero(12, 12);
  for (int c = 0; c < 2; ++c)
    for (int axis = 0; axis < 6; ++axis)
      to_body.block<1, 6>(6 * c + axis, 6 * c) =
          body_axis_of_extrinsics(rig.model.cameras[c], axis).transpose();
  Eigen::MatrixXd in_body = 2.5e-9 * Eigen::MatrixXd::Identity(12, 12);
  for (const int axis : {3, 4, 5})
    for (const int a : {axis, axis + 6})
      for (const int b : {axis, axis + 6}) in_body(a, b) += 25e-8;
  rig.result.covariance.block(at, at, 12, 12) = to_body.transpose() * in_body * to_body;
  rig.result.robust_covariance = rig.result.covariance;
  EXPECT_THAT(rig.unobservable_axes(0), IsEmpty());
}

}  // namespace
}  // namespace redrive
