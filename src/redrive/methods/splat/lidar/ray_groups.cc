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

/// Where and when a ray begins, from another ray's: units of kOffTrack_m and kOffTime_ns.
using Start = Eigen::Vector4d;

Start start_of(const kernels::Rays& all, int ray, int first) {
  Start start = Start::Zero();
  start.head<3>() = (vector_at(all.origin, all.n, ray).cast<double>() -
                     vector_at(all.origin, all.n, first).cast<double>()) /
                    kOffTrack_m;
  if (!all.t_ns.empty()) start[3] = double(all.t_ns[ray] - all.t_ns[first]) / kOffTime_ns;
  return start;
}

/// Sets the lines of origins and times by least squares. Returns the component of Start along which
/// rays are farthest off them, or nothing where all are near.
std::optional<int> fit_starts(const kernels::Rays& all, RayGroup* group) {
  const std::size_t n = group->rays.size();
  const int first = group->rays[0];
  double azimuth = 0, squares = 0;
  Start sum = Start::Zero(), products = sum;
  for (std::size_t k = 0; k < n; ++k) {
    const double at = group->azimuth[k];
    const Start start = start_of(all, group->rays[k], first);
    azimuth += at;
    squares += at * at;
    sum += start;
    products += at * start;
  }
  const double count = static_cast<double>(n), mean = azimuth / count,
               spread = squares - mean * azimuth;
  const Start by_azimuth =
      spread > 1e-9 * count ? Start((products - mean * sum) / spread) : Start::Zero();
  const Start at_zero = sum / count - mean * by_azimuth;
  group->by_azimuth_m = kOffTrack_m * by_azimuth.head<3>();
  group->origin_m =
      vector_at(all.origin, all.n, first).cast<double>() + kOffTrack_m * at_zero.head<3>();
  if (!all.t_ns.empty()) group->first_ns = all.t_ns[first];
  group->after_ns = kOffTime_ns * at_zero[3];
  group->by_azimuth_ns = kOffTime_ns * by_azimuth[3];
  Start most = Start::Zero();
  for (std::size_t k = 0; k < n; ++k)
    most = most.cwiseMax(
        (start_of(all, group->rays[k], first) - at_zero - double(group->azimuth[k]) * by_azimuth)
            .cwiseAbs());
  int component = 0;
  if (most.maxCoeff(&component) <= 1) return std::nullopt;
  return component;
}

/// Adds the group to `out`, cut into parts by where and when rays begin until each has a line.
void add_parts(const kernels::Rays& all, RayGroup group, std::vector<RayGroup>* out) {
  const std::optional<int> component = fit_starts(all, &group);
  if (!component) {
    out->push_back(std::move(group));
    return;
  }
  std::vector<double> along;
  for (const int ray : group.rays) along.push_back(start_of(all, ray, group.rays[0])[*component]);
  const auto [low, high] = std::ranges::minmax(along);
  const double middle = low + (high - low) / 2;
  RayGroup parts[2];
  for (RayGroup& part : parts) part.world_from_axes = group.world_from_axes;
  for (std::size_t k = 0; k < group.rays.size(); ++k) {
    RayGroup& part = parts[along[k] > middle];
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
