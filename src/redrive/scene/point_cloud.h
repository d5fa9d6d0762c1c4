// SPDX-License-Identifier: Apache-2.0
// Coloured points of the static world, from which a method may start.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "redrive/image/image.h"

namespace redrive {

/// Structure of arrays, as LidarReturns.
struct PointCloud {
  std::size_t n = 0;
  std::vector<float> position;   ///< [3, n] in the world, metres
  std::vector<float> rgb;        ///< [3, n] in [0, 1]
  std::vector<float> seen_from;  ///< [3, n] camera of the image that gives the colour, world metres
  std::vector<std::uint32_t> source;  ///< [n] index of the LiDAR return, ascending; 0 for others
};

struct ColouredPoint {
  Eigen::Vector3f in_world_m;
  std::array<std::uint8_t, 3> rgb;
  Eigen::Vector3f seen_from_m;
  std::uint32_t source = 0;
};

/// Returns the points of all parts, one part after the other.
PointCloud make_point_cloud(const std::vector<std::vector<ColouredPoint>>& parts);

/// Value of Image8::used where a moving object that the model draws may be: used, but not static.
constexpr std::uint8_t kMovingPixel = 128;

/// Returns the index of the pixel whose area holds `pixel` (integer coordinates are centres), or
/// nothing outside an image of this size.
std::optional<std::size_t> pixel_index(int width, int height, const Eigen::Vector2d& pixel);
/// Whether pixel `index` is neither masked nor transparent.
bool is_visible(const Image8& image, std::size_t index);
/// The same, and no moving object may be there.
bool is_static(const Image8& image, std::size_t index);
/// Returns pixel_index, or nothing where it is masked or not opaque.
std::optional<std::size_t> visible_pixel(const Image8& image, const Eigen::Vector2d& pixel);
/// The same, but nothing where a moving object may be.
std::optional<std::size_t> static_pixel(const Image8& image, const Eigen::Vector2d& pixel);

/// Returns the colour of pixel `index`.
inline std::array<std::uint8_t, 3> colour_at(const Image8& image, std::size_t index) {
  return {image.rgb[3 * index], image.rgb[3 * index + 1], image.rgb[3 * index + 2]};
}

}  // namespace redrive
