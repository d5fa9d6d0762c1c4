// SPDX-License-Identifier: Apache-2.0
// The surface points that an image shows, for fusion into a volume.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "redrive/render/renderer.h"

namespace redrive {

/// Directions of all pixels of a camera.
struct PixelDirections {
  Camera camera;
  std::vector<Eigen::Vector3f> of_pixel;  ///< [height, width], unit, camera axes; 0: no direction
  double half_angle_rad = 0;              ///< between the optical axis and the outermost pixel
};
std::shared_ptr<const PixelDirections> pixel_directions(const RayTable& table);

/// The surfaces that a camera sees: a piece of a plane in each pixel.
struct DepthImage {
  std::shared_ptr<const PixelDirections> directions;
  ShutterPoses world_from_camera;
  std::vector<float> depth_m;  ///< [height, width] along the ray; 0: no surface
  std::vector<std::array<std::int16_t, 3>> normal;  ///< [height, width], times 32767, camera axes
  std::vector<std::array<std::uint8_t, 3>> rgb;     ///< [height, width]

  std::uint64_t bytes() const;
  /// Returns the unit normal of a pixel with a depth, which is turned to the camera.
  Eigen::Vector3d normal_at(std::size_t pixel) const {
    return Eigen::Vector3d(normal[pixel][0], normal[pixel][1], normal[pixel][2]).normalized();
  }
};

/// Returns the surfaces of a rendered image. A pixel has none where `used` [height, width] is 0
/// (empty: all are used), where opacity is below `least_opacity`, and where depth determines no
/// plane.
DepthImage make_depth_image(const RenderedImage& image, const RayTable& table,
                            std::shared_ptr<const PixelDirections> directions,
                            const ShutterPoses& world_from_camera,
                            const std::vector<std::uint8_t>& used, float least_opacity = 0.9f);

}  // namespace redrive
