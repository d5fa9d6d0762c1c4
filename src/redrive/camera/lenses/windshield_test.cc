// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/windshield.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/camera/camera.h"
#include "redrive/camera/lenses/ftheta_intrinsics.h"

namespace redrive {
namespace {

/// A glass that bends as much as windshields of NVIDIA's cars do.
WindshieldPolynomials glass() {
  WindshieldPolynomials g;
  g.horizontal = {-5e-4, 0.9994, 1.7e-4, 2e-4, 5.5e-3, 9e-4};
  g.vertical = {1.5e-3, -5e-4, -6e-5, -4e-6, 6e-4,  1.0094,  -1.3e-3, 8.2e-3,
                -3e-4,  0.018, -3e-3, 6e-3,  0.017, -3.6e-3, 6.9e-3};
  g.horizontal_inverse = {0, 1, 0};
  g.vertical_inverse = {0, 0, 1};
  return g;
}

CameraCalibration calibration(bool inverse) {
  FThetaIntrinsics lens{.cx = 957.25, .cy = 603.5, .angle_is_reference = inverse};
  lens.angle_to_pixeldist = {0, 1000, 4, -30, 6, -1.5};
  lens.pixeldist_to_angle = {0, 1.0 / 1000, -6e-9, 2e-11, -1e-14, 3e-18};
  lens.max_angle_rad = 1.75;
  CameraCalibration camera{.name = "front", .width = 1920, .height = 1208};
  set_ftheta(lens, "rig.json", "front.", &camera);
  return camera;
}

/// The polynomials of NCore's documents, term by term.
double sum_of(const std::vector<double>& c, int order, double phi, double theta) {
  double sum = 0;
  std::size_t k = 0;
  for (int j = 0; j <= order; ++j)
    for (int i = 0; i <= order - j; ++i) sum += c[k++] * std::pow(phi, i) * std::pow(theta, j);
  return sum;
}

TEST(Windshield, BendsDirectionsBeforeTheLens) {
  const WindshieldPolynomials g = glass();
  for (const bool inverse : {false, true}) {
    CameraCalibration calibrated = calibration(inverse);
    const Camera lens = make_camera(calibrated);
    set_windshield(g, "rig.json", "front.", &calibrated);
    const Camera camera = make_camera(calibrated);
    for (double v = 0; v < camera.height; v += 50)
      for (double u = 0; u < camera.width; u += 50) {
        SCOPED_TRACE(testing::Message() << inverse << ' ' << u << ' ' << v);
        const auto ray = camera.unproject({u, v});
        ASSERT_TRUE(ray);
        const double phi = std::asin(ray->x()), theta = std::asin(ray->y()),
                     x = std::sin(sum_of(g.horizontal, 2, phi, theta)),
                     y = std::sin(sum_of(g.vertical, 4, phi, theta));
        const auto pixel = lens.project({x, y, std::sqrt(1 - x * x - y * y)});
        ASSERT_TRUE(pixel);
        EXPECT_LT((*pixel - Eigen::Vector2d(u, v)).norm(), 1e-6);
        const auto back = camera.project(7 * *ray);
        ASSERT_TRUE(back);
        EXPECT_LT((*back - *pixel).norm(), 1e-6);
      }
  }
}

TEST(Windshield, PolynomialsComeBack) {
  CameraCalibration camera = calibration(true);
  const FThetaIntrinsics lens = *ftheta_intrinsics(camera);
  EXPECT_FALSE(windshield_polynomials(camera));
  set_windshield(glass(), "rig.json", "front.", &camera);
  const auto back = windshield_polynomials(camera);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->horizontal, glass().horizontal);
  EXPECT_EQ(back->vertical, glass().vertical);
  const auto same = ftheta_intrinsics(camera);
  ASSERT_TRUE(same);
  EXPECT_EQ(same->pixeldist_to_angle, lens.pixeldist_to_angle);
  EXPECT_EQ(same->max_angle_rad, lens.max_angle_rad);
  for (const Eigen::Vector2d& a : {Eigen::Vector2d(0, 0), {0.6, 0.2}, {-0.3, -0.5}}) {
    const double phi = sum_of(back->horizontal, 2, a.x(), a.y()),
                 theta = sum_of(back->vertical, 4, a.x(), a.y());
    // A tenth of a pixel.
    EXPECT_NEAR(sum_of(back->horizontal_inverse, 2, phi, theta), a.x(), 1e-4);
    EXPECT_NEAR(sum_of(back->vertical_inverse, 4, phi, theta), a.y(), 1e-4);
  }
}

TEST(Windshield, PolynomialsOfLowerOrder) {
  WindshieldPolynomials g = glass();
  g.horizontal = {0.01, 1, 0.02};
  g.vertical = {0, 0.03, 0.04, 0.98, 0.05, 0.06};
  CameraCalibration camera = calibration(false);
  set_windshield(g, "rig.json", "front.", &camera);
  const auto back = windshield_polynomials(camera);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->horizontal, (std::vector<double>{0.01, 1, 0, 0.02, 0, 0}));
  EXPECT_EQ(back->vertical,
            (std::vector<double>{0, 0.03, 0.04, 0, 0, 0.98, 0.05, 0, 0, 0.06, 0, 0, 0, 0, 0}));
}

TEST(Windshield, EndsBeforeItFolds) {
  WindshieldPolynomials g = glass();
  g.horizontal = {0, 1, -0.6, 0, 0, 0};  // phi - 0.6 phi^2 falls from 0.83 on
  g.vertical = {0, 0, 1};
  CameraCalibration calibrated = calibration(false);
  set_windshield(g, "rig.json", "front.", &calibrated);
  const Camera camera = make_camera(calibrated);
  EXPECT_TRUE(camera.project({std::sin(0.6), 0, std::cos(0.6)}));
  EXPECT_FALSE(camera.project({std::sin(0.84), 0, std::cos(0.84)}));
  EXPECT_FALSE(camera.project({std::sin(1.1), 0, std::cos(1.1)}));
}

TEST(Windshield, RefusesPolynomialsByName) {
  const auto refused = [](auto change) -> std::string {
    WindshieldPolynomials g = glass();
    change(g);
    CameraCalibration camera = calibration(false);
    try {
      set_windshield(g, "rig.json", "front.", &camera);
    } catch (const InputError& error) {
      return error.field;
    }
    return "nothing";
  };
  EXPECT_EQ(refused([](WindshieldPolynomials&) {}), "nothing");
  EXPECT_EQ(refused([](WindshieldPolynomials& g) { g.horizontal.resize(10); }),
            "front.horizontal_poly");
  EXPECT_EQ(refused([](WindshieldPolynomials& g) { g.vertical.pop_back(); }),
            "front.vertical_poly");
  EXPECT_EQ(refused([](WindshieldPolynomials& g) { g.vertical[3] = NAN; }), "front.vertical_poly");
  EXPECT_EQ(refused([](WindshieldPolynomials& g) { g.horizontal[1] = -1; }),
            "front.horizontal_poly");
}

}  // namespace
}  // namespace redrive
