// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/depth_image.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/render/normals.h"

namespace redrive {

std::shared_ptr<const PixelDirections> pixel_directions(const RayTable& table) {
  auto directions = std::make_shared<PixelDirections>();
  directions->camera = table.camera;
  directions->of_pixel.resize(static_cast<std::size_t>(table.width) * table.height,
                              Eigen::Vector3f::Zero());
  float least_cosine = 1;
  for (std::size_t k = 0; k < table.pixel.size(); ++k) {
    const Eigen::Map<const Eigen::Vector3f> direction(&table.direction[3 * k]);
    directions->of_pixel[table.pixel[k]] = direction;
    least_cosine = std::min(least_cosine, direction.z());
  }
  // The outer half of a pixel looks beyond its middle.
  directions->half_angle_rad =
      std::acos(std::clamp(static_cast<double>(least_cosine), -1.0, 1.0)) + table.pixel_angle;
  return directions;
}

std::uint64_t DepthImage::bytes() const {
  return depth_m.size() * (sizeof(depth_m[0]) + sizeof(normal[0]) + sizeof(rgb[0]));
}

DepthImage make_depth_image(const RenderedImage& image, const RayTable& table,
                            std::shared_ptr<const PixelDirections> directions,
                            const ShutterPoses& world_from_camera,
                            const std::vector<std::uint8_t>& used, float least_opacity) {
  const std::size_t pixels = image.depth.size();
  REDRIVE_CHECK_OP(directions->of_pixel.size(), ==, pixels);
  REDRIVE_CHECK(used.empty() || used.size() == pixels);
  const std::vector<float> normals = surface_normals(image, table);
  const Image8 colours = to_image8(image);
  DepthImage out{std::move(directions), world_from_camera, std::vector<float>(pixels, 0.0f),
                 std::vector<std::array<std::int16_t, 3>>(pixels),
                 std::vector<std::array<std::uint8_t, 3>>(pixels)};
  for (std::size_t i = 0; i < pixels; ++i) {
    const float depth = image.depth[i];
    const Eigen::Map<const Eigen::Vector3f> normal(&normals[3 * i]);
    if ((!used.empty() && used[i] == 0) || !(image.opacity[i] >= least_opacity) || !(depth > 0) ||
        !std::isfinite(depth) || normal.isZero())
      continue;
    out.depth_m[i] = depth;
    for (int k = 0; k < 3; ++k) {
      out.normal[i][k] = static_cast<std::int16_t>(std::lround(32767 * normal[k]));
      out.rgb[i][k] = colours.rgb[3 * i + k];
    }
  }
  return out;
}

}  // namespace redrive
