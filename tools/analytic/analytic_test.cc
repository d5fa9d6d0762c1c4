// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/base/cpu_features.h"
#include "redrive/image/image_io.h"
#include "tools/analytic/recording_writer.h"

namespace redrive::analytic {
namespace {

using Eigen::Vector3d;

TEST(Trace, DistancesFollowTheFormulas) {
  Courtyard scene;
  scene.to_sun = Vector3d(0, 0, 1);
  scene.spheres.push_back({{5, 0, 1}, 0.5, Texture::kStripes, Vector3d::Ones(), Vector3d::Zero()});
  scene.boxes.push_back(
      {{-4, -1, 0}, {-3, 1, 2}, Texture::kChecker, Vector3d::Ones(), Vector3d::Zero()});
  EXPECT_NEAR(trace(scene, {0, 0, 1}, {1, 0, 0}).distance_m, 4.5, 1e-12);
  EXPECT_NEAR(trace(scene, {0, 0, 1}, {-1, 0, 0}).distance_m, 3, 1e-12);
  EXPECT_NEAR(trace(scene, {0, 3, 1}, Vector3d(1, 0, -1).normalized()).distance_m, std::sqrt(2.0),
              1e-12);
  EXPECT_EQ(trace(scene, {0, 3, 1}, {0, 0, 1}).distance_m, 0);
}

// Every pixel's depth against the closed form: inside the sphere's tangent cone the near root of
// its quadratic, else the ground plane, else sky.
TEST(CaptureImage, DepthOfEveryPixelFollowsTheFormula) {
  Courtyard scene;
  scene.to_sun = Vector3d(0, 0, 1);
  const Sphere sphere{{6, 0.4, 1.2}, 0.7, Texture::kStripes, Vector3d::Ones(), Vector3d::Zero()};
  scene.spheres.push_back(sphere);
  ThreadPool pool(1);
  for (const CameraCalibration& calibration : {rig_calibration()[0], rig_calibration()[2]}) {
    const Camera camera = make_camera(calibration);
    const Rigid3d world_from_camera = calibration.body_from_sensor;
    const Vector3d origin = world_from_camera.translation();
    const CapturedImage image = capture_image(scene, camera, world_from_camera, pool);
    int ground = 0, compared = 0;
    for (int y = 0; y < camera.height; ++y)
      for (int x = 0; x < camera.width; ++x) {
        const auto in_camera = camera.unproject({double(x), double(y)});
        if (!in_camera) continue;
        const Vector3d direction = world_from_camera.linear() * *in_camera;
        const Vector3d to_center = sphere.center - origin;
        const double miss =
            to_center.cross(direction).norm();  // distance of the ray's line from the centre
        if (std::abs(miss - sphere.radius) < 1e-6)
          continue;  // on the silhouette itself either answer is right
        double expected = direction.z() < 0 ? -origin.z() / direction.z() : 0;
        if (miss < sphere.radius && to_center.dot(direction) > 0)
          expected =
              to_center.dot(direction) - std::sqrt(sphere.radius * sphere.radius - miss * miss);
        else if (expected > 0)
          ++ground;
        ++compared;
        // Half a millimetre of rounding; 16 bits end at 65.535 m.
        ASSERT_NEAR(image.depth_mm[std::size_t(y) * camera.width + x] / 1000.0,
                    std::min(expected, 65.535), 0.000501)
            << calibration.name << " " << x << "," << y;
      }
    EXPECT_GT(ground, camera.width * camera.height / 5) << calibration.name;
    EXPECT_GT(compared, camera.width * camera.height / 2) << calibration.name;
  }
}

// A crate's corner is at the pixel of the camera model's projection: the image changes across it.
TEST(CaptureImage, KnownPointLandsWithinAThirdOfAPixel) {
  const Courtyard scene = [] {
    Courtyard s;
    s.to_sun = Vector3d(0, 0, 1);
    s.boxes.push_back(
        {{4, -1.3, 0.2}, {5, 0.7, 1.9}, Texture::kMetal, Vector3d::Ones(), Vector3d::Ones()});
    return s;
  }();
  const CameraCalibration calibration = rig_calibration()[0];
  const Camera camera = make_camera(calibration);
  const Rigid3d& world_from_camera = calibration.body_from_sensor;
  const Vector3d corner(4, 0.7, 1.9);  // front face, upper left as the camera sees it
  const auto pixel = camera.project(world_from_camera.inverse() * corner);
  ASSERT_TRUE(pixel);
  const auto distance_at = [&](double dx, double dy) {
    const auto direction = camera.unproject({pixel->x() + dx, pixel->y() + dy});
    return trace(scene, world_from_camera.translation(), world_from_camera.linear() * *direction)
        .distance_m;
  };
  const double expected = (corner - world_from_camera.translation()).norm();
  EXPECT_NEAR(distance_at(0.3, 0.3), expected, 0.02);
  EXPECT_GT(std::abs(distance_at(-0.3, 0.3) - expected), 1);
  EXPECT_GT(std::abs(distance_at(0.3, -0.3) - expected), 1);
}

TEST(Sample, ShippedImageEqualsTheGenerated) {
  const std::filesystem::path root = std::filesystem::path(REDRIVE_SAMPLES) / "analytic";
  ThreadPool pool(hardware_threads());
  const CameraCalibration calibration = rig_calibration()[2];
  const int index = 9;
  const CapturedImage made =
      capture_image(make_courtyard(1), make_camera(calibration),
                    world_from_body(index) * calibration.body_from_sensor, pool);
  const Image8 shipped = read_image(root / "sensor/camera/M_FISHEYE_L/M_FISHEYE_L_0001209.jpg");
  ASSERT_EQ(shipped.rgb.size(), made.image.rgb.size());
  double squared = 0;
  for (std::size_t i = 0; i < shipped.rgb.size(); ++i)
    squared += std::pow(double(shipped.rgb[i]) - made.image.rgb[i], 2);
  // JPEG at quality 92 leaves a few levels; another scene or pose leaves tens.
  EXPECT_LT(std::sqrt(squared / shipped.rgb.size()), 6.0);
}

TEST(Globe, PositionIsOnTheEllipsoid) {
  const Vector3d p = global_from_world().translation();
  const double a = 6378137.0 + 150, b = 6356752.3142 + 150;
  EXPECT_NEAR((p.x() * p.x() + p.y() * p.y()) / (a * a) + p.z() * p.z() / (b * b), 1, 1e-6);
  EXPECT_NEAR(global_from_world().linear().determinant(), 1, 1e-12);
}

}  // namespace
}  // namespace redrive::analytic
