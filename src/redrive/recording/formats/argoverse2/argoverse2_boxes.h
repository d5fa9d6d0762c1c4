// SPDX-License-Identifier: Apache-2.0
// Annotated objects of Argoverse 2: a table of cuboids in the vehicle's axes, at the times of the
// scans.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/core/box.h"
#include "redrive/recording/core/recording.h"

namespace redrive::argoverse2 {

struct Cuboid {
  std::int64_t t_ns = 0;  ///< time of its scan
  std::string track, category;
  Rigid3d body_from_box;  ///< at t_ns; axes as Box
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();
};

/// Returns the cuboids by time. Rows without a size, a place or a name go to `impossible`, in
/// words. InputError for a damaged table.
std::vector<Cuboid> parse_cuboids(std::string_view feather, const std::filesystem::path& file,
                                  std::vector<std::string>* impossible);

/// Whether the data set knows the category.
bool is_known_category(std::string_view category);

/// Returns the boxes of the frames, each at the time `holds_after(place in the body)` after its
/// scan, and in the frame that is nearest to the middle of its scan. A frame has the boxes of the
/// scan that is nearest to it. `poses`: the body's.
std::map<std::int64_t, std::vector<Box>> boxes_of_frames(
    const std::vector<Cuboid>& cuboids, const std::vector<FramePose>& poses,
    const std::vector<FramePose>& frames,
    const std::function<std::int64_t(const Eigen::Vector3d& in_body)>& holds_after);

}  // namespace redrive::argoverse2
