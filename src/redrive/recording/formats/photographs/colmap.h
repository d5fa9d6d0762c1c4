// SPDX-License-Identifier: Apache-2.0
// A COLMAP model with its photographs: cameras, images and points3D, binary or text, in sparse/0,
// in sparse, or in the folder itself, and the photographs in images. Binary files come first if
// both are there, as in COLMAP. Each image that exists is a frame of the recording; ids count in
// the order of their names. The body is at the camera, its x axis along the camera's z. The
// model's world and unit are the recording's.
#pragma once

#include <filesystem>

#include "redrive/recording/core/recording.h"

namespace redrive::colmap {

bool looks_like(const std::filesystem::path& root);
Recording open(const std::filesystem::path& root, PoseSource source);

}  // namespace redrive::colmap
