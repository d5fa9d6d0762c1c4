// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/point_cloud.h"

#include <cmath>

namespace redrive {

PointCloud make_point_cloud(const std::vector<std::vector<ColouredPoint>>& parts) {
  PointCloud cloud;
  for (const auto& part : parts) cloud.n += part.size();
  cloud.position.resize(3 * cloud.n);
  cloud.rgb.resize(3 * cloud.n);
  cloud.seen_from.resize(3 * cloud.n);
  std::size_t i = 0;
  for (const auto& part : parts)
    for (const ColouredPoint& point : part) {
      for (int d = 0; d < 3; ++d) {
        cloud.position[d * cloud.n + i] = point.in_world_m[d];
        cloud.seen_from[d * cloud.n + i] = point.seen_from_m[d];
        cloud.rgb[d * cloud.n + i] = static_cast<float>(point.rgb[d]) / 255;
      }
      cloud.source.push_back(point.source);
      ++i;
    }
  return cloud;
}

std::optional<std::size_t> pixel_index(int width, int height, const Eigen::Vector2d& pixel) {
  const double x = std::floor(pixel.x() + 0.5), y = std::floor(pixel.y() + 0.5);
  if (!(x >= 0 && y >= 0 && x < width && y < height)) return std::nullopt;
  return static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
}

bool is_visible(const Image8& image, std::size_t index) {
  return (image.used.empty() || image.used[index] != 0) &&
         (image.alpha.empty() || image.alpha[index] == 255);
}

bool is_static(const Image8& image, std::size_t index) {
  return is_visible(image, index) && (image.used.empty() || image.used[index] != kMovingPixel);
}

std::optional<std::size_t> visible_pixel(const Image8& image, const Eigen::Vector2d& pixel) {
  const auto i = pixel_index(image.width, image.height, pixel);
  return i && is_visible(image, *i) ? i : std::nullopt;
}

std::optional<std::size_t> static_pixel(const Image8& image, const Eigen::Vector2d& pixel) {
  const auto i = pixel_index(image.width, image.height, pixel);
  return i && is_static(image, *i) ? i : std::nullopt;
}

}  // namespace redrive
