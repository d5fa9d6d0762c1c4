// SPDX-License-Identifier: Apache-2.0
// Annotated objects of NCore: a list of boxes, each at its own time in the axes of the rig, of a
// sensor or of the world.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "redrive/recording/core/box.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/ncore/ncore_poses.h"
#include "redrive/recording/formats/ncore/ncore_stores.h"

namespace redrive::ncore {

struct Cuboid {
  std::int64_t t_ns = 0;
  std::string track, type;
  Rigid3d world_from_box;  ///< axes as Box
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();
};

/// Returns the cuboids by time. Those without a size, a place or a name go to `impossible`, in
/// words. InputError for a damaged list.
std::vector<Cuboid> read_cuboids(const Component& component, const Poses& poses,
                                 std::vector<std::string>* impossible);

/// Returns the boxes of frames. Each track has one box for each of `anchors` that it is near, the
/// nearest, and far from these for each frame. `frames`: the recording's, with poses from the world
/// of the cuboids; `anchors`: some of them.
std::map<std::int64_t, std::vector<Box>> boxes_of_frames(const std::vector<Cuboid>& cuboids,
                                                         const std::vector<FramePose>& frames,
                                                         const std::vector<FramePose>& anchors);

}  // namespace redrive::ncore
