// SPDX-License-Identifier: Apache-2.0
// For tests: depth images of analytic surfaces.
#pragma once

#include <functional>
#include <optional>

#include "redrive/export/depth_image.h"

namespace redrive {

constexpr std::uint64_t kAmpleMemory = std::uint64_t{1} << 30;

/// A surface that a ray meets.
struct SurfaceHit {
  double depth_m;
  Eigen::Vector3d normal;  ///< in the world, unit
  std::array<std::uint8_t, 3> rgb;
};
using Surface = std::function<std::optional<SurfaceHit>(const Eigen::Vector3d& origin,
                                                        const Eigen::Vector3d& direction)>;

/// A pinhole of 90 degrees without distortion.
inline Camera right_angle_camera(int size) {
  CameraCalibration calibration;
  calibration.name = "TEST";
  calibration.model = "opencv_pinhole";
  calibration.parameters = {0.5 * size, 0.5 * size, 0.5 * (size - 1), 0.5 * (size - 1), 0, 0, 0,
                            0,          0};
  calibration.width = calibration.height = size;
  return make_camera(calibration);
}

inline DepthImage see(const Surface& surface, const Camera& camera,
                      const ShutterPoses& world_from_camera) {
  const RayTable table = make_ray_table(camera);
  const std::size_t pixels = static_cast<std::size_t>(camera.width) * camera.height;
  DepthImage image{pixel_directions(table), world_from_camera, std::vector<float>(pixels, 0.0f),
                   std::vector<std::array<std::int16_t, 3>>(pixels),
                   std::vector<std::array<std::uint8_t, 3>>(pixels)};
  for (std::size_t i = 0; i < pixels; ++i) {
    const Rigid3d pose =
        world_from_camera.at_pixel(static_cast<int>(i) % camera.width,
                                   static_cast<int>(i) / camera.width, camera.width, camera.height);
    const auto hit =
        surface(pose.translation(), pose.linear() * image.directions->of_pixel[i].cast<double>());
    if (!hit) continue;
    image.depth_m[i] = static_cast<float>(hit->depth_m);
    const Eigen::Vector3d normal = pose.linear().transpose() * hit->normal;
    for (int k = 0; k < 3; ++k)
      image.normal[i][k] = static_cast<std::int16_t>(std::lround(32767 * normal[k]));
    image.rgb[i] = hit->rgb;
  }
  return image;
}

/// The pose of a camera at `position` that looks along `forward`, the world's z upwards.
inline Rigid3d looking(const Eigen::Vector3d& position, const Eigen::Vector3d& forward) {
  Rigid3d pose = Rigid3d::Identity();
  pose.translation() = position;
  const Eigen::Vector3d z = forward.normalized();
  const Eigen::Vector3d up =
      std::abs(z.z()) > 0.9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d x = z.cross(up).normalized();
  pose.linear() << x, z.cross(x), z;
  return pose;
}

/// The ground z = 0, of one colour. `has`: where it exists.
inline Surface ground_surface(const std::function<bool(double x, double y)>& has) {
  return [has](const Eigen::Vector3d& origin,
               const Eigen::Vector3d& direction) -> std::optional<SurfaceHit> {
    const double depth = -origin.z() / direction.z();
    const Eigen::Vector3d at = origin + depth * direction;
    if (!(depth > 0) || !has(at.x(), at.y())) return std::nullopt;
    return SurfaceHit{depth, Eigen::Vector3d::UnitZ(), {90, 100, 110}};
  };
}

}  // namespace redrive
