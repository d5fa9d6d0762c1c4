// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/normals.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include <Eigen/Cholesky>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr int kRadius = 3;  // radius of the window, pixels
constexpr float kLeastOpacity = 0.5f;
// largest difference of distances on one surface, as a part of the distance
constexpr double kSameSurface = 0.05;

/// Points of an image's pixels, in camera axes.
struct PointImage {
  int width, height;
  std::vector<Eigen::Vector3d> points;  ///< 0: no surface
  std::vector<double> distance;

  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
  /// Returns the vector n of the plane n . p = 1 that fits the pixel's surface best, or nothing.
  std::optional<Eigen::Vector3d> plane_at(int x, int y) const {
    const std::size_t centre = index(x, y);
    // Divides lengths by the pixel's distance, so that nothing depends on the scene's scale.
    const double scale = 1 / distance[centre];
    Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (int v = std::max(y - kRadius, 0); v <= std::min(y + kRadius, height - 1); ++v)
      for (int u = std::max(x - kRadius, 0); u <= std::min(x + kRadius, width - 1); ++u) {
        const std::size_t i = index(u, v);
        if (!(std::fabs(distance[i] * scale - 1) < kSameSurface)) continue;
        const Eigen::Vector3d p = scale * points[i];
        squares += p * p.transpose();
        sum += p;
      }
    const Eigen::LDLT<Eigen::Matrix3d> solver(squares);
    // Points on a line determine no plane.
    if (!(solver.vectorD().minCoeff() > 1e-9 * solver.vectorD().maxCoeff())) return std::nullopt;
    return solver.solve(sum);
  }
};

}  // namespace

std::vector<float> surface_normals(const RenderedImage& image, const RayTable& table) {
  REDRIVE_CHECK_OP(image.width, ==, table.width);
  REDRIVE_CHECK_OP(image.height, ==, table.height);
  const std::size_t pixels = static_cast<std::size_t>(image.width) * image.height;
  PointImage seen{image.width, image.height,
                  std::vector<Eigen::Vector3d>(pixels, Eigen::Vector3d::Zero()),
                  std::vector<double>(pixels, 0.0)};
  for (std::size_t k = 0; k < table.pixel.size(); ++k) {
    const std::size_t i = table.pixel[k];
    if (!(image.opacity[i] >= kLeastOpacity) || !(image.depth[i] > 0)) continue;
    seen.distance[i] = static_cast<double>(image.depth[i]);
    seen.points[i] = seen.distance[i] *
                     Eigen::Map<const Eigen::Vector3f>(&table.direction[3 * k]).cast<double>();
  }
  std::vector<float> normals(3 * pixels, 0.0f);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const std::size_t i = seen.index(x, y);
      if (seen.distance[i] == 0) continue;
      const auto plane = seen.plane_at(x, y);
      if (!plane || !(plane->norm() > 0)) continue;
      const Eigen::Vector3d normal =
          (plane->dot(seen.points[i]) > 0 ? -1.0 : 1.0) * plane->normalized();
      for (int k = 0; k < 3; ++k) normals[3 * i + k] = static_cast<float>(normal[k]);
    }
  return normals;
}

Image8 normals_image(const RenderedImage& image, const RayTable& table) {
  const std::vector<float> normals = surface_normals(image, table);
  Image8 out{image.width, image.height, std::vector<std::uint8_t>(normals.size(), 0)};
  for (std::size_t i = 0; i < normals.size(); i += 3) {
    if (normals[i] == 0 && normals[i + 1] == 0 && normals[i + 2] == 0) continue;
    for (std::size_t c = 0; c < 3; ++c)
      out.rgb[i + c] = static_cast<std::uint8_t>(
          std::lround(127.5f * (1 + (c == 0 ? 1.0f : -1.0f) * normals[i + c])));
  }
  return out;
}

}  // namespace redrive
