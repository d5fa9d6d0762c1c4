// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/camera.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>
#include <Eigen/LU>
#include <opencv2/calib3d.hpp>

#include "redrive/base/error.h"
#include "redrive/camera/example_cameras_testing.h"
#include "redrive/math/dual.h"

namespace redrive {
namespace {

/// Directions all over the sphere, none on an axis: spirals of equal area.
std::vector<Eigen::Vector3d> directions(int n) {
  std::vector<Eigen::Vector3d> all;
  for (int i = 0; i < n; ++i) {
    const double z = 1 - (2 * i + 1.0) / n, r = std::sqrt(1 - z * z), angle = 2.399963229728653 * i;
    all.emplace_back(r * std::cos(angle), r * std::sin(angle), z);
  }
  return all;
}

// Every whole and half pixel: what is unprojected comes back, and what is refused lies outside the
// image of the valid disc.
TEST(Camera, RoundTripsOverTheWholeImage) {
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    int seen = 0, refused = 0;
    for (double v = -0.5; v < camera.height; v += 0.5)
      for (double u = -0.5; u < camera.width; u += 0.5) {
        const Eigen::Vector2d pixel(u, v);
        const auto direction = camera.unproject(pixel);
        if (!direction) {
          ++refused;
          const double distance =
              std::hypot((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
          ASSERT_GT(distance, covered_radius(camera) - 1e-9) << u << ' ' << v;
          continue;
        }
        ++seen;
        ASSERT_NEAR(direction->norm(), 1, 1e-15 * 4);
        const auto back = camera.project(*direction * 3.7);
        ASSERT_TRUE(back) << u << ' ' << v;
        ASSERT_LT((*back - pixel).norm(), 1e-6) << u << ' ' << v;
      }
    EXPECT_GT(seen, 0);
    const bool expected = example.name.find("fold") != std::string::npos ||
                          example.name.find("sphere") != std::string::npos ||
                          example.name == "sixth order" || example.name == "fisheye";
    EXPECT_EQ(refused > 0, expected) << refused;
  }
}

// One-to-one: what is projected is found again from its pixel, whatever the direction.
TEST(Camera, UnprojectInvertsProject) {
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    int seen = 0;
    for (const Eigen::Vector3d& direction : directions(20000)) {
      const auto pixel = example.camera.project(direction);
      if (!pixel) continue;
      ++seen;
      const auto back = example.camera.unproject(*pixel);
      ASSERT_TRUE(back) << direction.transpose();
      // At the fold a pixel determines its radius to the square root of its own rounding:
      // (1e-12)^(1/2) f at worst.
      ASSERT_LT((*back - direction).norm(), folds(example.camera) ? 1e-5 : 1e-9)
          << direction.transpose();
    }
    EXPECT_GT(seen, 1000);
  }
}

TEST(BrownConrady, FoldRadiusIsTheFirstRootOfTheDerivative) {
  EXPECT_TRUE(std::isinf(BrownConrady({0, 0, 0, 0, 0}).max_radius));
  EXPECT_TRUE(std::isinf(BrownConrady({0.3, 0.1, 0, 0, 0.01}).max_radius));
  // 1 + 3 k1 s + 5 k2 s^2 has no real root: 9 k1^2 < 20 k2.
  EXPECT_TRUE(std::isinf(BrownConrady({-0.3, 0.08, 0, 0, 0}).max_radius));
  EXPECT_NEAR(BrownConrady({-0.4, 0, 0, 0, 0}).max_radius, std::sqrt(1 / 1.2), 1e-14);
  // 9 k1^2 > 20 k2: two roots, s = (-3 k1 -+ sqrt(9 k1^2 - 20 k2)) / (10 k2); the nearer one
  // counts.
  const double near_root = (1.2 - std::sqrt(1.44 - 20 * 0.06)) / 0.6;
  EXPECT_NEAR(BrownConrady({-0.4, 0.06, 0, 0, 0}).max_radius, std::sqrt(near_root), 1e-13);
  EXPECT_NEAR(BrownConrady({0, 0, 0, 0, -1.0 / 7}).max_radius, 1, 1e-14);  // 1 - s^3
}

TEST(BrownConrady, TangentialTermsShrinkTheValidRegion) {
  const std::array<double, 5> coefficients{-0.4, 0.01, 0.004, -0.003, 0};
  const BrownConrady lens(coefficients);
  ASSERT_TRUE(std::isfinite(lens.max_radius));
  const auto smallest_determinant = [&](double r) {
    double smallest = 1e300;
    for (int i = 0; i < 3600; ++i) {
      using D = Dual<double, 2>;
      const double angle = i * std::numbers::pi / 1800;
      const auto d = lens.distort<D>(
          {D::variable(r * std::cos(angle), 0), D::variable(r * std::sin(angle), 1)});
      smallest = std::min(smallest, d[0].d[0] * d[1].d[1] - d[0].d[1] * d[1].d[0]);
    }
    return smallest;
  };
  for (int i = 0; i <= 100; ++i) EXPECT_GT(smallest_determinant(lens.max_radius * i / 100), 0) << i;
  // Not smaller than need be: the radial derivative falls with slope 6 k1 r = -2 there, and the
  // bound gives away 2/3 |p| r.
  EXPECT_LT(smallest_determinant(lens.max_radius * 1.01), 0);
}

TEST(Camera, RejectsPointsOutsideTheValidRegion) {
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    EXPECT_FALSE(camera.project({0, 0, -1}));
    EXPECT_FALSE(camera.project({0, 0, 0}));
    EXPECT_FALSE(camera.project({NAN, 0, 1}));
    EXPECT_FALSE(camera.unproject({NAN, 10}));
    EXPECT_FALSE(camera.unproject({INFINITY, 10}));
    ASSERT_TRUE(camera.project({0, 0, 2}));
    EXPECT_LT((*camera.project({0, 0, 2}) - Eigen::Vector2d(camera.cx, camera.cy)).norm(), 1e-12);
    EXPECT_LT((*camera.unproject({camera.cx, camera.cy}) - Eigen::Vector3d(0, 0, 1)).norm(), 1e-12);
  }
}

TEST(Camera, RefusesTheFoldedBackPoint) {
  // r g(r^2) with k1 = -0.4: r = 0.8 and r = 1.0198... are seen at the same distance from the
  // centre; only the first is true.
  const Camera camera = example_cameras()[3].camera;
  const double seen_at = 0.8 * (1 - 0.4 * 0.64);
  // 0.4 r^3 - r + seen_at = 0 divided by (r - 0.8): 0.4 r^2 + 0.32 r - 0.744.
  const double folded = (-0.32 + std::sqrt(0.32 * 0.32 + 4 * 0.4 * 0.744)) / 0.8;
  ASSERT_NEAR(folded * (1 - 0.4 * folded * folded), seen_at, 1e-12);
  EXPECT_TRUE(camera.project({0.8, 0, 1}));
  EXPECT_FALSE(camera.project({folded, 0, 1}));
  const auto direction = camera.unproject({camera.cx + camera.fx * seen_at, camera.cy});
  ASSERT_TRUE(direction);
  EXPECT_NEAR(direction->x() / direction->z(), 0.8, 1e-12);
}

TEST(Mei, ValidRegionEndsAtTheEdgeOfTheSphere) {
  const Camera camera =
      example_cameras()[8].camera;  // xi = 1.5: cos a > -1/xi, r < 1/sqrt(xi^2 - 1)
  const auto at_angle = [](double a) { return Eigen::Vector3d(std::sin(a), 0, std::cos(a)); };
  const double edge = std::acos(-1 / 1.5);
  EXPECT_TRUE(camera.project(at_angle(edge - 1e-3)));
  EXPECT_FALSE(camera.project(at_angle(edge + 1e-3)));
  const double reach = camera.fx / std::sqrt(1.5 * 1.5 - 1);
  EXPECT_TRUE(camera.unproject({camera.cx + reach * (1 - 1e-6), camera.cy}));
  EXPECT_FALSE(camera.unproject({camera.cx + reach * (1 + 1e-6), camera.cy}));
}

TEST(Mei, ParabolicMirrorIsStereographic) {  // xi = 1: r = sin a / (1 + cos a) = tan(a / 2)
  const Camera camera = example_cameras()[9].camera;
  for (const double angle : {0.1, 1.0, 2.0, 3.0}) {
    const auto pixel = camera.project({0, std::sin(angle), std::cos(angle)});
    ASSERT_TRUE(pixel);
    EXPECT_NEAR(pixel->y(), camera.cy + camera.fy * std::tan(angle / 2), 1e-9);
  }
}

TEST(OpenCvFisheye, EquidistantProjectsBehindTheCamera) {
  const Camera camera = example_cameras()[11].camera;
  for (const double angle : {0.1, 1.0, 2.0, 3.0}) {
    const auto pixel = camera.project({0, 5 * std::sin(angle), 5 * std::cos(angle)});
    ASSERT_TRUE(pixel);
    EXPECT_NEAR(pixel->y(), camera.cy + camera.fy * angle, 1e-9);
    const auto direction = camera.unproject(*pixel);
    ASSERT_TRUE(direction);
    EXPECT_LT((*direction - Eigen::Vector3d(0, std::sin(angle), std::cos(angle))).norm(), 1e-11);
  }
  EXPECT_FALSE(camera.unproject({camera.cx, camera.cy + 3.15 * camera.fy}))
      << "beyond straight behind";
}

// theta = a - 0.1 a^3 rises to a = 1 / sqrt(0.3).
TEST(OpenCvFisheye, ValidRegionEndsWhereThetaFalls) {
  const OpenCvFisheye fisheye({-0.1, 0, 0, 0, 0});
  EXPECT_NEAR(fisheye.max_angle_rad, 1 / std::sqrt(0.3), 1e-12);
  const auto at = [](double a) { return std::array<double, 3>{std::sin(a), 0, std::cos(a)}; };
  EXPECT_TRUE(fisheye.project<double>(at(fisheye.max_angle_rad - 1e-6)));
  EXPECT_FALSE(fisheye.project<double>(at(fisheye.max_angle_rad + 1e-6)));
  EXPECT_NEAR(OpenCvFisheye().max_angle_rad, std::numbers::pi, 1e-8);
}

TEST(OpenCvFisheye, AgreesWithOpenCv) {
  int compared = 0;
  for (const ExampleCamera& example : example_cameras()) {
    const Camera& camera = example.camera;
    const OpenCvFisheye* fisheye = std::get_if<OpenCvFisheye>(&camera.model);
    if (!fisheye) continue;
    SCOPED_TRACE(example.name);
    std::vector<cv::Point3d> points;
    std::vector<Eigen::Vector2d> ours;
    for (const Eigen::Vector3d& direction : directions(5000)) {
      if (direction.z() < 0.01) continue;  // OpenCV divides by z
      points.emplace_back(4 * direction.x(), 4 * direction.y(), 4 * direction.z());
      const auto pixel = camera.project(direction * 4);
      ASSERT_TRUE(pixel);
      ours.push_back(*pixel);
    }
    const cv::Matx33d k(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
    std::vector<cv::Point2d> theirs;
    cv::fisheye::projectPoints(points, theirs, cv::Vec3d(), cv::Vec3d(), k,
                               cv::Vec4d(fisheye->k1, fisheye->k2, fisheye->k3, fisheye->k4));
    for (std::size_t i = 0; i < points.size(); ++i)
      ASSERT_LT(std::hypot(ours[i].x() - theirs[i].x, ours[i].y() - theirs[i].y), 1e-6)
          << points[i];
    ++compared;
  }
  EXPECT_EQ(compared, 3);
}

TEST(Camera, DualNumbersAgreeWithFiniteDifferences) {
  using D = Dual<double, 3>;
  // Central differences of a function of order 1 on points of length 1: step^2 f'''/6 (f''' <= 1e3
  // this far from the edge) and 2e-16 / step of rounding.
  const double step = 1e-6, tolerance = 1e-8;
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    int tested = 0;
    std::visit(
        [&](const auto& model) {
          for (const Eigen::Vector3d& direction : directions(400)) {
            const double angle = std::acos(direction.z());
            if (angle > 1 || !model.template project<double>(
                                 {1.1 * direction.x(), 1.1 * direction.y(), direction.z()}))
              continue;
            ++tested;
            const auto gradient = model.template project<D>({D::variable(direction.x(), 0),
                                                             D::variable(direction.y(), 1),
                                                             D::variable(direction.z(), 2)});
            ASSERT_TRUE(gradient);
            for (int k = 0; k < 3; ++k) {
              std::array<double, 3> ahead{direction.x(), direction.y(), direction.z()},
                  behind = ahead;
              ahead[k] += step;
              behind[k] -= step;
              const auto a = model.template project<double>(ahead),
                         b = model.template project<double>(behind);
              ASSERT_TRUE(a && b);
              for (int i = 0; i < 2; ++i)
                ASSERT_NEAR((*gradient)[i].d[k], ((*a)[i] - (*b)[i]) / (2 * step), tolerance)
                    << direction.transpose();
            }
          }
        },
        example.camera.model);
    EXPECT_GT(tested, 10);
  }
}

TEST(Camera, PinholeAgreesWithOpenCv) {
  for (const ExampleCamera& example : example_cameras()) {
    if (!std::holds_alternative<OpenCvPinhole>(example.camera.model)) continue;
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    const BrownConrady& lens = *brown_conrady_of(camera);
    std::vector<cv::Point3d> points;
    std::vector<Eigen::Vector2d> ours;
    for (const Eigen::Vector3d& direction : directions(5000))
      if (const auto pixel = camera.project(direction * 4); pixel && pixel->norm() < 1e4) {
        points.emplace_back(4 * direction.x(), 4 * direction.y(), 4 * direction.z());
        ours.push_back(*pixel);
      }
    ASSERT_GT(points.size(), 200u);
    const cv::Matx33d k(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
    std::vector<cv::Point2d> theirs;
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), k,
                      cv::Vec<double, 5>(lens.k1, lens.k2, lens.p1, lens.p2, lens.k3), theirs);
    for (std::size_t i = 0; i < points.size(); ++i)
      ASSERT_LT(std::hypot(ours[i].x() - theirs[i].x, ours[i].y() - theirs[i].y), 1e-6)
          << points[i];
  }
}

TEST(Camera, DownscaledPixelIsTheMeanOfItsBlock) {
  for (const ExampleCamera& example : example_cameras()) {
    const Camera& camera = example.camera;
    const Camera small = camera.downscaled(3);
    EXPECT_EQ(small.width, 106);
    EXPECT_EQ(small.height, 66);
    // Pixel (k, l) covers the pixels 3k..3k+2, whose centre is 3k + 1.
    const auto direction = small.unproject({50, 40});
    ASSERT_TRUE(direction);
    EXPECT_LT((*camera.project(*direction) - Eigen::Vector2d(151, 121)).norm(), 1e-9);
  }
}

TEST(Camera, UndistortedIsThePinholeOfTheSameMatrix) {
  const Camera camera = example_cameras()[1].camera, plain = camera.undistorted();
  EXPECT_STREQ(plain.model_name(), "opencv_pinhole");
  const auto pixel = plain.project({0.2, -0.1, 2});
  ASSERT_TRUE(pixel);
  EXPECT_NEAR(pixel->x(), camera.fx * 0.1 + camera.cx, 1e-12);
  EXPECT_NEAR(pixel->y(), -camera.fy * 0.05 + camera.cy, 1e-12);
  EXPECT_THROW(example_cameras()[6].camera.undistorted(), std::logic_error);
}

TEST(Camera, UnknownModelIsRefused) {
  CameraCalibration calibration;
  calibration.name = "CAM";
  calibration.model = "rational";
  calibration.fx = calibration.fy = 1;
  try {
    make_camera(calibration);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("CAM.model = rational"), std::string::npos)
        << error.what();
  }
}

}  // namespace
}  // namespace redrive
