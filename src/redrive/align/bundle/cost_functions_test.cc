// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/cost_functions.h"

#include <gtest/gtest.h>

#include <ceres/cost_function.h>

#include "redrive/align/bundle/synthetic_rig_testing.h"
#include "redrive/camera/example_cameras_testing.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

using testing::SyntheticNoise;

/// Compares every Jacobian with central differences. A difference over 2 h is off by h^2 f''' / 6
/// and by the residual's rounding over h.
void expect_slopes(const ceres::CostFunction& term, std::vector<std::vector<double>> blocks,
                   double tolerance) {
  const auto& sizes = term.parameter_block_sizes();
  ASSERT_EQ(blocks.size(), sizes.size());
  std::vector<double*> at;
  std::vector<std::vector<double>> slopes;
  std::vector<double*> slope_at;
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    ASSERT_EQ(static_cast<int>(blocks[b].size()), sizes[b]);
    at.push_back(blocks[b].data());
    slopes.emplace_back(term.num_residuals() * sizes[b]);
  }
  for (auto& s : slopes) slope_at.push_back(s.data());
  std::vector<double> r(term.num_residuals()), plus(r), minus(r);
  ASSERT_TRUE(term.Evaluate(at.data(), r.data(), slope_at.data()));
  ASSERT_LT(std::abs(r[0]), kUnseen);
  constexpr double h = 1e-5;
  for (std::size_t b = 0; b < blocks.size(); ++b)
    for (std::size_t k = 0; k < blocks[b].size(); ++k) {
      const double value = blocks[b][k];
      blocks[b][k] = value + h;
      term.Evaluate(at.data(), plus.data(), nullptr);
      blocks[b][k] = value - h;
      term.Evaluate(at.data(), minus.data(), nullptr);
      blocks[b][k] = value;
      for (int i = 0; i < term.num_residuals(); ++i) {
        const double difference = (plus[i] - minus[i]) / (2 * h);
        EXPECT_NEAR(slopes[b][i * sizes[b] + k], difference, tolerance * (1 + std::abs(difference)))
            << "block " << b << " number " << k << " residual " << i;
      }
    }
}

std::vector<double> random_block(SyntheticNoise* noise, std::vector<double> sizes) {
  for (double& s : sizes) s *= noise->uniform(-1, 1);
  return sizes;
}
const std::vector<double> kCorrectionSizes{0.5, 0.5, 0.5, 0.1, 0.1, 0.1};

LocalMotion some_instant() {
  const testing::SyntheticRig rig = testing::make_synthetic_rig({.points = 0, .lidar_points = 0});
  LocalMotion motion =
      make_rig_model(rig.recording).motion_at(rig.recording.frames[11].t_ns + 20'000'000);
  motion.angular_velocity = {0.2, -0.3, 0.6};
  return motion;
}

TEST(CostFunctions, ReprojectionJacobiansOfEveryCameraModel) {
  SyntheticNoise noise(3);
  const LocalMotion motion = some_instant();
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    RigModelCamera camera;
    camera.initial = testing::synthetic_camera(1);
    camera.camera = example.camera;
    camera.offset_s = 0.004;
    camera.readout_s = 0.025;
    const Eigen::Vector2d pixel(180, 110);
    const auto ray = example.camera.unproject(pixel);
    ASSERT_TRUE(ray);
    InverseDepthPoint point;
    const Rigid3d world_from_camera = motion.world_from_body * camera.initial.body_from_sensor;
    point.anchor = world_from_camera.translation() + Eigen::Vector3d(0.3, -0.2, 0.1);
    point.axes.col(2) = world_from_camera.linear() * *ray;
    point.axes.col(0) = point.axes.col(2).unitOrthogonal();
    point.axes.col(1) = point.axes.col(2).cross(point.axes.col(0));
    const auto term = reprojection_cost(camera, motion, pixel, 0.3, point);
    for (const double inverse_m : {0.0, 0.02, 0.3})
      expect_slopes(*term,
                    {random_block(&noise, kCorrectionSizes),
                     random_block(&noise, kCorrectionSizes),
                     random_block(&noise, {0.05, 0.05, 0.05, 0.02, 0.02, 0.02}),
                     {noise.uniform(-0.01, 0.01)},
                     {noise.uniform(-0.05, 0.05)},
                     random_block(&noise, {0.01, 2, 2}),
                     {0.01, -0.02, inverse_m}},
                    2e-5);
  }
}

TEST(CostFunctions, ReprojectionAgreesWithTheRigModel) {
  testing::SyntheticRig rig = testing::make_synthetic_rig({.points = 0, .lidar_points = 0});
  RigModel model = make_rig_model(rig.recording);
  SyntheticNoise noise(4);
  for (Vector6d& c : model.corrections)
    for (int k = 0; k < 6; ++k) c[k] = noise.uniform(-0.1, 0.1);
  RigModelCamera& camera = model.cameras[1];
  for (int k = 0; k < 6; ++k) camera.extrinsics[k] = noise.uniform(-0.02, 0.02);
  const LocalMotion with_initial_values = model.image_motion(1, 7);
  const RigModelCamera before = camera;
  const auto held = reprojection_cost(before, with_initial_values, {0, 0}, 0.5, {});
  constexpr double kLater_s = 0.013;
  camera.offset_s = kLater_s;  // between frames 7 and 8 of the initial motion
  camera.intrinsics = {0.01, 1.5, -2};
  LocalMotion later = with_initial_values;
  Rigid3d motion = Rigid3d::Identity();
  motion.linear() = so3_exp(with_initial_values.angular_velocity * kLater_s);
  motion.translation() = with_initial_values.velocity * kLater_s;
  later.world_from_body = with_initial_values.world_from_body * motion;
  later.weight += kLater_s / later.duration_s;
  const Eigen::Vector3d in_world =
      model.corrected_pose(later) * model.body_from_sensor(1) * Eigen::Vector3d(0.4, -0.3, 5);
  const std::array<double, 3> point{in_world.x() / in_world.z(), in_world.y() / in_world.z(),
                                    1 / in_world.z()};
  const double* blocks[] = {model.corrections[7].data(),
                            model.corrections[8].data(),
                            camera.extrinsics.data(),
                            &camera.offset_s,
                            &camera.readout_s,
                            camera.intrinsics.data(),
                            point.data()};
  Eigen::Vector2d residual;
  held->Evaluate(blocks, residual.data(), nullptr);
  const auto pixel = model.camera(1).project({0.4, -0.3, 5});
  ASSERT_TRUE(pixel);
  EXPECT_LT((0.5 * residual - *pixel).norm(),
            1e-7);  // metres near 0, pixels in hundreds: 1e-9 and less

  // The upper edge of the image is read half a readout before its middle.
  constexpr double kReadout_s = 0.014;
  camera.offset_s = kLater_s + kReadout_s / 2;
  camera.readout_s = kReadout_s;
  const auto upper_edge = reprojection_cost(before, with_initial_values, {0, -0.5}, 0.5, {});
  upper_edge->Evaluate(blocks, residual.data(), nullptr);
  EXPECT_LT((0.5 * residual - *pixel - Eigen::Vector2d(0, 0.5)).norm(), 1e-7);
}

// A point on a plane through the origin of the surface, seen from the body at the present poses.
TEST(CostFunctions, PointsOnTheSurfaceHaveNoResidual) {
  testing::SyntheticRig rig = testing::make_synthetic_rig({.points = 0, .lidar_points = 0});
  RigModel model = make_rig_model(rig.recording);
  SyntheticNoise noise(6);
  for (Vector6d& c : model.corrections)
    for (int k = 0; k < 6; ++k) c[k] = noise.uniform(-0.1, 0.1);
  const LocalMotion motion = model.motion_at(model.initial_frames[7].t_ns + 20'000'000);
  const SurfaceElement surface{{5, -1, 0.5}, Eigen::Vector3d(1, 2, 2) / 3, 0.05};
  const Rigid3d world_from_body = model.corrected_pose(motion);
  InverseDepthPoint point;
  point.anchor = world_from_body.translation();
  for (const double off_m : {0.0, 0.1}) {
    const Eigen::Vector3d in_body =
                              surface.in_body + Eigen::Vector3d(2, -1, 0) + off_m * surface.normal,
                          ray = world_from_body.linear() * in_body;
    point.axes.col(2) = ray.normalized();
    point.axes.col(0) = ray.unitOrthogonal();
    point.axes.col(1) = point.axes.col(2).cross(point.axes.col(0));
    const double value[3] = {0, 0, 1 / ray.norm()};
    const double* blocks[] = {model.corrections[motion.segment].data(),
                              model.corrections[motion.segment + 1].data(), value};
    double residual = 1;
    ASSERT_TRUE(
        point_on_surface_cost(motion, surface, point)->Evaluate(blocks, &residual, nullptr));
    EXPECT_NEAR(residual, off_m / 0.05, 1e-8);
  }
}

TEST(CostFunctions, RowsHaveTheirOwnTimes) {
  const testing::SyntheticRig rig = testing::make_synthetic_rig({.points = 0, .lidar_points = 0});
  RigModel model = make_rig_model(rig.recording);
  RigModelCamera& camera = model.cameras[1];
  camera.offset_s = 0.004;
  const double height = camera.camera.height;
  const std::int64_t t_ns = model.initial_frames[7].t_ns;
  const auto apart = [](const LocalMotion& a, const LocalMotion& b) {
    return (a.world_from_body.matrix() - b.world_from_body.matrix()).norm() +
           std::abs(a.weight - b.weight);
  };
  EXPECT_EQ(apart(model.pixel_motion(1, 7, {0, 12}), model.image_motion(1, 7)),
            0);  // all rows at one time
  camera.readout_s = 0.03;
  EXPECT_LT(apart(model.pixel_motion(1, 7, {0, (height - 1) / 2}), model.image_motion(1, 7)), 1e-9);
  EXPECT_LT(
      apart(model.pixel_motion(1, 7, {0, -0.5}), model.motion_at(t_ns + 4'000'000 - 15'000'000)),
      1e-9);
  EXPECT_EQ(model.pixel_motion(1, 7, {0, -0.5}).segment, 6);  // before its frame
  EXPECT_LT(apart(model.pixel_motion(1, 7, {0, height - 0.5}),
                  model.motion_at(t_ns + 4'000'000 + 15'000'000)),
            1e-9);
  EXPECT_EQ(model.corrected_calibration(1).readout_ns, 30'000'000);
  camera.initial.readout_by_column = true;
  EXPECT_LT(apart(model.pixel_motion(1, 7, {-0.5, height}),
                  model.motion_at(t_ns + 4'000'000 - 15'000'000)),
            1e-9);
  EXPECT_TRUE(model.corrected_calibration(1).readout_by_column);
}

TEST(CostFunctions, PointsOutOfViewHaveZeroJacobians) {
  const LocalMotion motion = some_instant();
  RigModelCamera camera;
  camera.initial = testing::synthetic_camera(0);
  camera.camera = make_camera(camera.initial);
  InverseDepthPoint behind;
  behind.anchor = motion.world_from_body.translation();
  behind.axes.col(2) = -motion.world_from_body.linear().col(0);
  behind.axes.col(0) = behind.axes.col(2).unitOrthogonal();
  behind.axes.col(1) = behind.axes.col(2).cross(behind.axes.col(0));
  const auto term = reprojection_cost(camera, motion, {100, 100}, 1, behind);
  const Vector6d zero = Vector6d::Zero();
  const double offset = 0, readout = 0, point[3] = {0, 0, 0.1};
  const double* blocks[] = {zero.data(), zero.data(), zero.data(), &offset,
                            &readout,    zero.data(), point};
  double residual[2], slope[12] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
  double* slopes[] = {slope, nullptr, nullptr, nullptr, nullptr, nullptr, nullptr};
  ASSERT_TRUE(term->Evaluate(blocks, residual, slopes));
  EXPECT_EQ(residual[0], kUnseen);
  for (const double s : slope) EXPECT_EQ(s, 0);
}

TEST(CostFunctions, PlaneAndPriorJacobians) {
  SyntheticNoise noise(5);
  PlaneParameters plane;
  plane.centre = {12, 3, 1};
  plane.axes = so3_exp({0.4, 0.9, -0.3});
  Rigid3d body_from_lidar = Rigid3d::Identity();
  body_from_lidar.linear() = so3_exp({0.1, -0.2, 0.7});
  body_from_lidar.translation() = Eigen::Vector3d(1, 0.2, 1.8);
  const auto term =
      point_to_plane_cost(some_instant(), {body_from_lidar, {6, -2, 0.7}}, 0.02, plane);
  for (int i = 0; i < 3; ++i)
    expect_slopes(*term,
                  {random_block(&noise, kCorrectionSizes), random_block(&noise, kCorrectionSizes),
                   random_block(&noise, {0.05, 0.05, 0.1}), random_block(&noise, {0.01})},
                  2e-5);
  InverseDepthPoint point;
  point.anchor = {1, 2, 1.5};
  point.axes = so3_exp({0.2, -0.7, 0.4});
  const auto tie = point_on_surface_cost(
      some_instant(), {{6, -2, 0.7}, Eigen::Vector3d(0.3, -0.2, 0.9).normalized(), 0.02}, point);
  for (const double inverse_m : {0.1, 0.3})
    expect_slopes(*tie,
                  {random_block(&noise, kCorrectionSizes),
                   random_block(&noise, kCorrectionSizes),
                   {0.02, -0.01, inverse_m}},
                  2e-5);
  const Vector6d sigmas = (Vector6d() << 0.1, 0.2, 0.3, 0.01, 0.02, 0.03).finished();
  expect_slopes(*pose_prior_cost(sigmas), {random_block(&noise, kCorrectionSizes)}, 1e-6);
  expect_slopes(*smoothness_cost(sigmas),
                {random_block(&noise, kCorrectionSizes), random_block(&noise, kCorrectionSizes)},
                1e-6);
  expect_slopes(*direction_prior_cost(sigmas, 0.3), {random_block(&noise, kCorrectionSizes)}, 1e-6);
  expect_slopes(*scalar_prior_cost(6, 4, 0.3), {random_block(&noise, kCorrectionSizes)}, 1e-6);
  const double value = 0.5, *block = &value;
  double residual = 0;
  scalar_prior_cost(1, 0, 0.25, 0.1)->Evaluate(&block, &residual, nullptr);
  EXPECT_DOUBLE_EQ(residual, 1.6);
}

}  // namespace
}  // namespace redrive
