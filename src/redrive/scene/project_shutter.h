// SPDX-License-Identifier: Apache-2.0
// Projection into images whose rows or columns have their own poses.
#pragma once

#include <optional>

#include "redrive/camera/camera.h"
#include "redrive/scene/shutter_poses.h"

namespace redrive {

struct ShutterPixel {
  Eigen::Vector2d pixel;      ///< continuous, may lie outside the image
  Eigen::Vector3d in_camera;  ///< the point when its pixel was exposed
};

/// Returns where the camera sees a point of the world, or nothing outside the valid region of its
/// model. `camera_from_world`: at the middle line.
inline std::optional<ShutterPixel> project_shutter(const Camera& camera,
                                                   const ShutterPoses& world_from_camera,
                                                   const Rigid3d& camera_from_world,
                                                   const Eigen::Vector3d& in_world) {
  Eigen::Vector3d in_camera = camera_from_world * in_world;
  auto pixel = camera.project(in_camera);
  // The line determines the pose and the pose the line, which moves by less each time.
  for (int i = 0; i < 3 && pixel && world_from_camera.is_rolling(); ++i) {
    in_camera = world_from_camera.at_pixel(pixel->x(), pixel->y(), camera.width, camera.height)
                    .inverse(Eigen::Isometry) *
                in_world;
    pixel = camera.project(in_camera);
  }
  if (!pixel) return std::nullopt;
  return ShutterPixel{*pixel, in_camera};
}

}  // namespace redrive
