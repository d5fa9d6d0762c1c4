// SPDX-License-Identifier: Apache-2.0
// The drive from above, and a camera's distance from the driven way.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/scene/scene.h"

namespace redrive::view {

class DriveMap {
 public:
  explicit DriveMap(const Scene& scene);

  /// Returns [[x, y], ..], the places of the frames' bodies (cameras of photographs) in the plane
  /// across the world's direction up.
  nlohmann::json frames() const;

  /// Returns [x, y, dx, dy] of a camera: its place in that plane and its viewing direction.
  nlohmann::json place(const Rigid3d& world_from_camera) const;

  /// Returns the distance from a camera's place to the way that the rig's camera of this name took,
  /// straight between frames; from all cameras' ways where the rig has none of this name. For
  /// photographs: to the nearest place.
  double beside(const std::string& camera, const Eigen::Vector3d& place_in_world) const;

 private:
  using Way = std::vector<Eigen::Vector3d>;
  bool joined_;  ///< frames follow each other in time
  Eigen::Matrix<double, 2, 3> plane_from_world_;
  Way bodies_;
  std::map<std::string, Way> ways_;  ///< ways of the rig's cameras
};

}  // namespace redrive::view
