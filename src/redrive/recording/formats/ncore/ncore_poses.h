// SPDX-License-Identifier: Apache-2.0
// Poses of a sequence: rigid transforms between named axes, fixed ones and ones that move.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/ncore/ncore_stores.h"

namespace redrive::ncore {

struct Poses {
  std::vector<FramePose> world_from_rig;  ///< increasing times; ids count
  /// first_from_second, keyed by second and first: ("camera", "rig") is rig_from_camera
  std::map<std::pair<std::string, std::string>, Rigid3d> fixed;
  std::filesystem::path file;  ///< file of world_from_rig, for messages

  /// Returns `to`_from_`from`, through as many fixed transforms as it takes, in either direction;
  /// nothing where none lead there.
  std::optional<Rigid3d> between(const std::string& from, const std::string& to) const;
};

/// Reads a poses component. Moving poses that cannot be go to `damaged`. InputError without poses
/// of the rig in the world.
Poses read_poses(const Component& component, Recording* recording);

}  // namespace redrive::ncore
