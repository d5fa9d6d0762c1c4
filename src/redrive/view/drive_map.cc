// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/drive_map.h"

#include <algorithm>
#include <limits>

#include <nlohmann/json.hpp>

#include "redrive/render/view_pose.h"
#include "redrive/view/server/outgoing.h"

namespace redrive::view {
namespace {

constexpr double kStep = 1e-3;  // step to which numbers are rounded

/// Returns the distance from `point` to the way from `a` to `b`.
double distance_to(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                   const Eigen::Vector3d& point) {
  const Eigen::Vector3d way = b - a;
  const double length2 = way.squaredNorm();
  const double share = length2 > 0 ? std::clamp((point - a).dot(way) / length2, 0.0, 1.0) : 0;
  return (a + share * way - point).norm();
}

}  // namespace

DriveMap::DriveMap(const Scene& scene) : joined_(scene.metric) {
  const Eigen::Vector3d up = up_in_world(scene);
  // The world's x, or y where x points up, and the axis to its left.
  const Eigen::Vector3d axis =
      std::abs(up.x()) < 0.9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
  const Eigen::Vector3d right = (axis - axis.dot(up) * up).normalized();
  plane_from_world_.row(0) = right;
  plane_from_world_.row(1) = up.cross(right);
  for (const PosedFrame& frame : scene.posed_frames()) {
    bodies_.push_back(frame.world_from_body.translation());
    for (const RigCamera& camera : scene.rig)
      ways_[camera.name].push_back(frame.world_from_body * camera.body_from_sensor.translation());
  }
}

nlohmann::json DriveMap::frames() const {
  nlohmann::json places = nlohmann::json::array();
  for (const Eigen::Vector3d& body : bodies_) {
    const Eigen::Vector2d at = plane_from_world_ * body;
    places.push_back({rounded(at.x(), kStep), rounded(at.y(), kStep)});
  }
  return places;
}

nlohmann::json DriveMap::place(const Rigid3d& world_from_camera) const {
  const Eigen::Vector2d at = plane_from_world_ * world_from_camera.translation(),
                        ahead = plane_from_world_ * world_from_camera.linear().col(2);
  return {rounded(at.x(), kStep), rounded(at.y(), kStep), rounded(ahead.x(), kStep),
          rounded(ahead.y(), kStep)};
}

double DriveMap::beside(const std::string& camera, const Eigen::Vector3d& place_in_world) const {
  double nearest = std::numeric_limits<double>::infinity();
  for (const auto& [name, way] : ways_) {
    if (name != camera && ways_.contains(camera)) continue;
    for (std::size_t i = 0; i < way.size(); ++i)
      nearest = std::min(
          nearest,
          distance_to(way[i], way[joined_ && i + 1 < way.size() ? i + 1 : i], place_in_world));
  }
  return nearest;
}

}  // namespace redrive::view
