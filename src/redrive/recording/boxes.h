// SPDX-License-Identifier: Apache-2.0
// The annotated objects of a frame: dynamic/box/3d_body/frame_<id>.json of the aiMotive layout.
//   {"Timestamp": "<ns>", "CapturedObjects": [{"ObjectId", "ObjectType", "ActorName",
//   "BoundingBox3D Origin X|Y|Z",
//    "BoundingBox3D Extent X|Y|Z", "BoundingBox3D Orientation Quat W|X|Y|Z", "Relative Velocity
//    X|Y|Z"}]}
// "Occluded" and "Truncated" are not read: in the data set they are always 0.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/math/rigid3.h"

namespace redrive {

struct Box {
  std::int64_t object_id = 0;  ///< the same object in every frame of the recording; once per frame
  std::string type;            ///< "CAR", "TRUCK", ...
  std::string actor_name;
  std::int64_t t_ns = 0;  ///< host clock: when the box holds
  Rigid3d body_from_box;  ///< box axes x along the object's length, forward, y left, z up; the
                          ///< origin is its centre
  Eigen::Vector3d
      size_m;  ///< full, along the box's axes: the box reaches size_m / 2 from its origin
  Eigen::Vector3d velocity_in_body_m_per_s;  ///< the object's minus the ego vehicle's, in body axes
};

/// The boxes in the order of the file; an object once. InputError for what is missing, not finite
/// or no box: quaternions whose norm is not 1 to 1e-3, sizes outside 0.01..100 m, centres further
/// than 1e4 m, speeds beyond 300 m/s.
std::vector<Box> parse_boxes(std::string_view text, const std::filesystem::path& file);
std::vector<Box> read_boxes(const std::filesystem::path& file);

}  // namespace redrive
