// SPDX-License-Identifier: Apache-2.0
// Annotated objects of a frame in the aiMotive layout, dynamic/box/3d_body/frame_<id>.json:
//   {"Timestamp": "<ns>", "CapturedObjects": [{"ObjectId", "ObjectType", "ActorName",
//   "BoundingBox3D Origin X|Y|Z",
//    "BoundingBox3D Extent X|Y|Z", "BoundingBox3D Orientation Quat W|X|Y|Z", "Relative Velocity
//    X|Y|Z"}]}
// "Occluded" and "Truncated" are not read: in the data set they are always 0.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/recording/core/box.h"

namespace redrive::aimotive {

/// Returns the boxes in the order of the file, each object once. InputError: missing fields,
/// numbers that are not finite, quaternions whose norm is not 1 to 1e-3, sizes outside 0.01..100 m,
/// centres further than 1e4 m, speeds beyond 300 m/s.
std::vector<Box> parse_boxes(std::string_view text, const std::filesystem::path& file);
std::vector<Box> read_boxes(const std::filesystem::path& file);

/// The file of a frame's boxes. Their own times are not written.
nlohmann::json boxes_to_json(std::int64_t t_ns, const std::vector<Box>& boxes);

}  // namespace redrive::aimotive
