// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/ray_groups.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <span>
#include <utility>

#include <Eigen/Geometry>

namespace redrive {
namespace {

constexpr int kFaces = 6;  // four sides, then up and down
/// Height of a unit direction from which on it belongs to the face above or below: the sine of 55
/// degrees, which leaves those faces 35 degrees around the poles of the sides.
constexpr float kHigh = 0.82f;

int face_of(const Eigen::Vector3f& direction) {
  if (std::abs(direction.z()) > kHigh) return direction.z() > 0 ? 4 : 5;
  if (std::abs(direction.x()) >= std::abs(direction.y())) return direction.x() > 0 ? 0 : 1;
  return direction.y() > 0 ? 2 : 3;
}

Eigen::Matrix3d world_from_face(int face) {
  Eigen::Matrix3d axes;
  axes.col(2) = (face % 2 ? -1 : 1) * Eigen::Vector3d::Unit(face / 2);
  axes.col(1) = face < 4 ? Eigen::Vector3d(-Eigen::Vector3d::UnitZ()) : Eigen::Vector3d::UnitX();
  axes.col(0) = axes.col(1).cross(axes.col(2));
  return axes;
}

Eigen::Vector3f vector_at(std::span<const float> xyz, std::size_t n, std::size_t i) {
  return {xyz[i], xyz[n + i], xyz[2 * n + i]};
}

/// Sets the origin's line by least squares. Returns the axis of the world along which rays are
/// farthest off it, or nothing where all are near.
std::optional<int> fit_origin(const kernels::Rays& all, RayGroup* group) {
  const std::size_t n = group->rays.size();
  const auto origin = [&](std::size_t k) {
    return vector_at(all.origin, all.n, group->rays[k]).cast<double>().eval();
  };
  const Eigen::Vector3d first = origin(0);
  double azimuth = 0, squares = 0;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero(), products = sum;
  for (std::size_t k = 0; k < n; ++k) {
    const double at = group->azimuth[k];
    const Eigen::Vector3d from_first = origin(k) - first;
    azimuth += at;
    squares += at * at;
    sum += from_first;
    products += at * from_first;
  }
  const double count = static_cast<double>(n), mean = azimuth / count,
               spread = squares - mean * azimuth;
  group->by_azimuth_m = spread > 1e-9 * count ? Eigen::Vector3d((products - mean * sum) / spread)
                                              : Eigen::Vector3d::Zero();
  group->origin_m = first + sum / count - mean * group->by_azimuth_m;
  Eigen::Vector3d most = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < n; ++k)
    most = most.cwiseMax((origin(k) - group->origin_at(group->azimuth[k])).cwiseAbs());
  int axis = 0;
  if (most.maxCoeff(&axis) <= kOffTrack_m) return std::nullopt;
  return axis;
}

/// Adds the group to `out`, cut into parts by the position of origins until each has a line.
void add_parts(const kernels::Rays& all, RayGroup group, std::vector<RayGroup>* out) {
  const std::optional<int> axis = fit_origin(all, &group);
  if (!axis) {
    out->push_back(std::move(group));
    return;
  }
  const std::span<const float> along = all.origin.subspan(std::size_t(*axis) * all.n, all.n);
  float low = along[group.rays[0]], high = low;
  for (const int ray : group.rays) {
    low = std::min(low, along[ray]);
    high = std::max(high, along[ray]);
  }
  const float middle = low + (high - low) / 2;
  RayGroup parts[2];
  for (RayGroup& part : parts) part.world_from_axes = group.world_from_axes;
  for (std::size_t k = 0; k < group.rays.size(); ++k) {
    RayGroup& part = parts[along[group.rays[k]] > middle];
    part.rays.push_back(group.rays[k]);
    part.azimuth.push_back(group.azimuth[k]);
    part.elevation.push_back(group.elevation[k]);
  }
  group = {};
  for (RayGroup& part : parts) add_parts(all, std::move(part), out);
}

/// Adds a ray whose direction in the group's axes is given.
void add_ray(int ray, const Eigen::Vector3f& in_axes, RayGroup* group) {
  group->rays.push_back(ray);
  group->azimuth.push_back(std::atan2(in_axes.x(), in_axes.z()));
  group->elevation.push_back(std::asin(std::clamp(in_axes.y(), -1.0f, 1.0f)));
}

}  // namespace

std::vector<RayGroup> group_rays(const kernels::Rays& rays, ThreadPool& pool) {
  std::array<RayGroup, kFaces> faces;
  std::array<std::vector<RayGroup>, kFaces> parts;
  std::array<std::vector<int>, kFaces> of_face;
  for (int i = 0; i < rays.n; ++i)
    of_face[face_of(vector_at(rays.direction, rays.n, i))].push_back(i);
  pool.run(kFaces, [&](int f) {
    RayGroup& face = faces[f];
    if (of_face[f].empty()) return;
    face.world_from_axes = world_from_face(f);
    const Eigen::Matrix3f face_from_world = face.world_from_axes.transpose().cast<float>();
    for (const int ray : of_face[f])
      add_ray(ray, face_from_world * vector_at(rays.direction, rays.n, ray), &face);
    add_parts(rays, std::move(face), &parts[f]);
  });
  std::vector<RayGroup> out;
  for (std::vector<RayGroup>& of_face : parts)
    for (RayGroup& part : of_face) out.push_back(std::move(part));
  return out;
}

std::vector<RayGroup> group_around(const kernels::Rays& rays,
                                   const Eigen::Matrix3d& world_from_axes) {
  constexpr float kAside_rad = 1.4f;
  RayGroup group;
  group.world_from_axes = world_from_axes;
  const Eigen::Matrix3f axes_from_world = world_from_axes.transpose().cast<float>();
  for (int i = 0; i < rays.n; ++i) {
    const Eigen::Vector3f d = axes_from_world * vector_at(rays.direction, rays.n, i);
    if (std::abs(std::atan2(d.x(), d.z())) < kAside_rad) add_ray(i, d, &group);
  }
  std::vector<RayGroup> out;
  if (!group.rays.empty()) add_parts(rays, std::move(group), &out);
  return out;
}

}  // namespace redrive
