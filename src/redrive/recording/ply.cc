// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/ply.h"

#include <cmath>

#include "redrive/base/files.h"
#include "redrive/recording/ply_vertices.h"

namespace redrive {
namespace {

constexpr std::size_t kMaxPlyPoints = 100'000'000;
constexpr double kMaxPlyCoordinate_m = 1e6;

}  // namespace

std::vector<Eigen::Vector3d> parse_ply(std::string_view bytes, const std::filesystem::path& file) {
  PlyVertices vertices(bytes, file, kMaxPlyPoints);
  std::vector<Eigen::Vector3d> points;
  points.reserve(vertices.size());
  const std::string names[] = {"x", "y", "z"};
  vertices.read(names, [&](std::size_t index, std::span<const double> values) {
    for (std::size_t k = 0; k < 3; ++k)
      if (!(std::abs(values[k]) <= kMaxPlyCoordinate_m))
        vertices.fail("vertex " + std::to_string(index) + " " + names[k], std::to_string(values[k]),
                      "must be metres, at most 1e6");
    points.emplace_back(values[0], values[1], values[2]);
  });
  return points;
}

std::vector<Eigen::Vector3d> read_ply(const std::filesystem::path& file) {
  return parse_ply(read_file(file, kMaxDataBytes), file);
}

std::string make_ply(std::span<const PlyPoint> points, bool normals,
                     std::span<const Triangle> triangles) {
  std::string bytes = "ply\nformat binary_little_endian 1.0\nelement vertex " +
                      std::to_string(points.size()) + "\n";
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"})
    if (name[0] != 'n' || normals) bytes += std::string("property float ") + name + "\n";
  for (const char* name : {"red", "green", "blue"})
    bytes += std::string("property uchar ") + name + "\n";
  if (!triangles.empty())
    bytes += "element face " + std::to_string(triangles.size()) +
             "\nproperty list uchar int vertex_indices\n";
  bytes += "end_header\n";
  const auto add = [&](const void* data, std::size_t size) {
    bytes.append(static_cast<const char*>(data), size);
  };
  for (const PlyPoint& point : points) {
    add(point.position.data(), 3 * sizeof(float));
    if (normals) add(point.normal.data(), 3 * sizeof(float));
    add(point.rgb.data(), point.rgb.size());
  }
  for (const Triangle& triangle : triangles) {
    bytes += static_cast<char>(triangle.size());
    add(triangle.data(), sizeof triangle);
  }
  return bytes;
}

}  // namespace redrive
