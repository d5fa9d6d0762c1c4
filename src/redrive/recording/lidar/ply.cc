// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/ply.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/files/files.h"
#include "redrive/recording/lidar/ply_vertices.h"

namespace redrive {
namespace {

constexpr std::size_t kMaxPlyPoints = 100'000'000;
constexpr double kMaxPlyCoordinate = 1e7;  // as of photographs; ECEF in metres is 6.4e6

}  // namespace

std::vector<Eigen::Vector3d> parse_ply(std::string_view bytes, const std::filesystem::path& file,
                                       std::size_t* left_out) {
  PlyVertices vertices(bytes, file, kMaxPlyPoints);
  std::vector<Eigen::Vector3d> points;
  points.reserve(vertices.size());
  const std::string names[] = {"x", "y", "z"};
  vertices.read(names, [&](std::size_t, std::span<const double> values) {
    if (std::ranges::all_of(values, [](double x) { return std::abs(x) <= kMaxPlyCoordinate; }))
      points.emplace_back(values[0], values[1], values[2]);
  });
  if (points.empty() && vertices.size() > 0)
    vertices.fail("element vertex", std::to_string(vertices.size()),
                  "has no point with finite coordinates of at most 1e7");
  if (left_out) *left_out = vertices.size() - points.size();
  return points;
}

std::vector<Eigen::Vector3d> read_ply(const std::filesystem::path& file, std::size_t* left_out) {
  return parse_ply(read_file(file, kMaxDataBytes), file, left_out);
}

std::string make_ply(std::span<const PlyPoint> points, bool normals,
                     std::span<const Triangle> triangles, const Eigen::Vector3d& origin) {
  const bool is_far = !origin.isZero(0);
  std::string bytes = "ply\nformat binary_little_endian 1.0\nelement vertex " +
                      std::to_string(points.size()) + "\n";
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"})
    if (name[0] != 'n' || normals)
      bytes += std::string(is_far && name[0] != 'n' ? "property double " : "property float ") +
               name + "\n";
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
    if (const Eigen::Vector3d position = origin + point.position.cast<double>(); is_far)
      add(position.data(), 3 * sizeof(double));
    else
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
