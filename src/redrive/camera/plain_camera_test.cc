// SPDX-License-Identifier: Apache-2.0
// Every model of the registry, as kernels project through it.
#include "redrive/camera/plain_camera.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/camera/example_cameras_testing.h"

namespace redrive {
namespace {

using Math = NumberMath<double>;

/// The typical lens of each model in front of a narrow and of a wide image.
std::vector<ExampleCamera> typical_cameras() {
  std::vector<ExampleCamera> cameras;
  for (const CameraModelInfo& model : camera_models())
    for (const double f : {250.0, 130.0}) {
      CameraCalibration c{
          std::string(model.name), std::string(model.name), {f, 0.96 * f, 163.25, 98.5}, 320, 200};
      c.parameters.insert(c.parameters.end(), model.typical.begin(), model.typical.end());
      cameras.push_back({c.name + " " + std::to_string(f), make_camera(c)});
    }
  return cameras;
}

/// The camera's parameters are rounded to floats: a few ulps of the distance from the principal
/// point.
double tolerance(const Camera& camera, const Eigen::Vector2d& pixel) {
  return 1e-6 * (camera.fx + (pixel - Eigen::Vector2d(camera.cx, camera.cy)).norm());
}

bool is_at_edge(const Camera& camera, const Eigen::Vector2d& pixel) {
  return std::hypot((pixel.x() - camera.cx) / camera.fx, (pixel.y() - camera.cy) / camera.fy) >
         0.999 * camera.covered_radius();
}

PlainPixel<Math> projected(const PlainCamera& camera, const Eigen::Vector3d& point) {
  return project<Math>(camera, point.x(), point.y(), point.z());
}

void expect_derivatives(const Camera& camera, const PlainCamera& plain,
                        const Eigen::Vector3d& point) {
  constexpr double kStep = 1e-5;
  double d_u[3] = {0.5, 0, 0}, d_v[3] = {};  // accumulates
  project_adjoint<Math>(plain, point.x(), point.y(), point.z(), 1, 0, d_u);
  project_adjoint<Math>(plain, point.x(), point.y(), point.z(), 0, 1, d_v);
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(k);
    const auto ahead = camera.project(point + step), behind = camera.project(point - step);
    ASSERT_TRUE(ahead && behind);
    const Eigen::Vector2d difference = (*ahead - *behind) / (2 * kStep);
    // Relative to the derivatives of this lens, f / distance.
    const double most = 1e-5 * camera.fx / point.norm();
    EXPECT_NEAR(d_u[k] - (k == 0 ? 0.5 : 0), difference.x(), most) << k;
    EXPECT_NEAR(d_v[k], difference.y(), most) << k;
  }
}

TEST(PlainCamera, ProjectsAsTheCameraUpToTheCorners) {
  for (const ExampleCamera& example : typical_cameras()) {
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    const PlainCamera plain = make_plain_camera(camera);
    EXPECT_EQ(plain.width, 320);
    EXPECT_EQ(plain.height, 200);
    int compared = 0;
    for (int row = 0; row <= 20; ++row)
      for (int column = 0; column <= 32; ++column) {
        const Eigen::Vector2d pixel(10 * column - 0.5, 10 * row - 0.5);
        const auto direction = camera.unproject(pixel);
        if (!direction || is_at_edge(camera, pixel)) continue;
        ++compared;
        const Eigen::Vector3d point = 3.7 * *direction;
        const PlainPixel<Math> at = projected(plain, point);
        ASSERT_TRUE(at.valid) << pixel.transpose();
        ASSERT_NEAR(at.u, pixel.x(), tolerance(camera, pixel));
        ASSERT_NEAR(at.v, pixel.y(), tolerance(camera, pixel));
        ASSERT_NO_FATAL_FAILURE(expect_derivatives(camera, plain, point)) << pixel.transpose();
      }
    EXPECT_GT(compared, 300) << "of 693";
  }
}

TEST(PlainCamera, PointsSomewhatOutsideTheImageAreValid) {
  int compared = 0;
  for (const ExampleCamera& example : typical_cameras()) {
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    const PlainCamera plain = make_plain_camera(camera);
    for (const double u : {-12.0, 331.0})
      for (const double v : {-7.0, 206.0}) {
        const auto direction = camera.unproject({u, v});
        if (!direction || is_at_edge(camera, {u, v})) continue;
        ++compared;
        EXPECT_TRUE(projected(plain, *direction).valid) << u << " " << v;
      }
  }
  EXPECT_GE(compared, 4 * static_cast<int>(camera_models().size()));
}

// Beyond the fold a second, wrong point would land in the image.
TEST(PlainCamera, NothingIsValidThatTheCameraRejects) {
  std::vector<ExampleCamera> cameras = typical_cameras();
  for (const ExampleCamera& example : example_cameras()) cameras.push_back(example);
  for (const ExampleCamera& example : cameras) {
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    const PlainCamera plain = make_plain_camera(camera);
    EXPECT_FALSE(projected(plain, {0, 0, -1}).valid);
    int valid = 0;
    for (const Eigen::Vector3d& direction : directions(10000)) {
      const PlainPixel<Math> at = projected(plain, 3.7 * direction);
      if (!at.valid) continue;
      ++valid;
      const auto pixel = camera.project(direction);
      ASSERT_TRUE(pixel) << direction.transpose();
      ASSERT_NEAR(at.u, pixel->x(), tolerance(camera, *pixel)) << direction.transpose();
      ASSERT_NEAR(at.v, pixel->y(), tolerance(camera, *pixel)) << direction.transpose();
    }
    EXPECT_GT(valid, 100);
  }
}

TEST(PlainCamera, AWindowShiftsThePixels) {
  for (const ExampleCamera& example : typical_cameras()) {
    SCOPED_TRACE(example.name);
    const PlainCamera whole = make_plain_camera(example.camera),
                      window = window_of(whole, 48, 32, 100, 60);
    EXPECT_EQ(window.width, 100);
    EXPECT_EQ(window.height, 60);
    for (const Eigen::Vector3d& point :
         {Eigen::Vector3d(0, 0, 2), Eigen::Vector3d(0.4, -0.2, 1.5)}) {
      const PlainPixel<Math> a = projected(whole, point), b = projected(window, point);
      EXPECT_TRUE(a.valid && b.valid);
      EXPECT_NEAR(b.u, a.u - 48, 1e-4);
      EXPECT_NEAR(b.v, a.v - 32, 1e-4);
    }
  }
}

}  // namespace
}  // namespace redrive
