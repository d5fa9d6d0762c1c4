// SPDX-License-Identifier: Apache-2.0
// Annotated objects of PandaSet: a table of cuboids in the world for each scan.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/core/box.h"
#include "redrive/recording/core/recording.h"

namespace redrive::pandaset {

struct Cuboid {
  std::string uuid, sibling;  ///< sibling: the same object as the other LiDAR saw it; may be empty
  std::string label;
  bool has_rider = false;
  int sensor = -1;         ///< Lidar that saw it, where both may; else -1
  Rigid3d world_from_box;  ///< axes as Box
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();
};

/// Returns the cuboids of a table. Ones without a size, a place or a name go to `impossible`, in
/// words. InputError for a damaged table.
std::vector<Cuboid> parse_cuboids(std::string_view pickle, const std::filesystem::path& file,
                                  std::vector<std::string>* impossible);

/// Whether the data set knows the label.
bool is_known_label(std::string_view label);

/// Returns the boxes of the frames: siblings are one object, which is the Pandar64's where both
/// LiDARs saw it. A box holds when the laser of the Pandar64 passed it, since a moving object is
/// elsewhere at the time of the frame.
std::map<std::int64_t, std::vector<Box>> boxes_of_frames(
    const std::map<std::int64_t, std::vector<Cuboid>>& cuboids, const Rigid3d& body_from_lidar,
    const std::vector<FramePose>& frames);

}  // namespace redrive::pandaset
