// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/normals.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr int kRadius = 3;  // radius of the window, pixels
constexpr float kLeastOpacity = 0.5f;
// largest difference of distances on one surface, as a part of the distance
constexpr double kSameSurface = 0.05;

}  // namespace

SurfaceNormals::SurfaceNormals(const RenderedImage& image, const RayTable& table)
    : width_(image.width),
      height_(image.height),
      points_(image.depth.size(), Eigen::Vector3d::Zero()),
      distance_(image.depth.size(), 0.0) {
  REDRIVE_CHECK_OP(image.width, ==, table.width);
  REDRIVE_CHECK_OP(image.height, ==, table.height);
  for (std::size_t k = 0; k < table.pixel.size(); ++k) {
    const std::size_t i = table.pixel[k];
    if (!(image.opacity[i] >= kLeastOpacity) || !(image.depth[i] > 0)) continue;
    distance_[i] = static_cast<double>(image.depth[i]);
    points_[i] =
        distance_[i] * Eigen::Map<const Eigen::Vector3f>(&table.direction[3 * k]).cast<double>();
  }
}

Eigen::Vector3d SurfaceNormals::at(std::size_t pixel) const {
  if (distance_[pixel] == 0) return Eigen::Vector3d::Zero();
  const int x = static_cast<int>(pixel % width_), y = static_cast<int>(pixel / width_);
  // Divides lengths by the pixel's distance, so that nothing depends on the scene's scale.
  const double scale = 1 / distance_[pixel];
  Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int v = std::max(y - kRadius, 0); v <= std::min(y + kRadius, height_ - 1); ++v)
    for (int u = std::max(x - kRadius, 0); u <= std::min(x + kRadius, width_ - 1); ++u) {
      const std::size_t i = static_cast<std::size_t>(v) * width_ + u;
      if (!(std::fabs(distance_[i] * scale - 1) < kSameSurface)) continue;
      const Eigen::Vector3d p = scale * points_[i];
      squares += p * p.transpose();
      sum += p;
    }
  const Eigen::LDLT<Eigen::Matrix3d> solver(squares);
  // Points on a line determine no plane.
  if (!(solver.vectorD().minCoeff() > 1e-9 * solver.vectorD().maxCoeff()))
    return Eigen::Vector3d::Zero();
  const Eigen::Vector3d plane = solver.solve(sum);  // n of the plane n . p = 1
  if (!(plane.norm() > 0)) return Eigen::Vector3d::Zero();
  return (plane.dot(points_[pixel]) > 0 ? -1.0 : 1.0) * plane.normalized();
}

std::vector<float> surface_normals(const RenderedImage& image, const RayTable& table) {
  const SurfaceNormals surface(image, table);
  std::vector<float> normals(3 * image.depth.size());
  for (std::size_t i = 0; i < image.depth.size(); ++i) {
    const Eigen::Vector3f normal = surface.at(i).cast<float>();
    std::copy_n(normal.data(), 3, &normals[3 * i]);
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
