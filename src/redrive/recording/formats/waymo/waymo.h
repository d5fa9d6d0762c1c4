// SPDX-License-Identifier: Apache-2.0
// Segments of the Waymo Open Dataset, version 1: a .tfrecord file, or a folder with one.
// docs/recordings.md has conventions and sources.
#pragma once

#include <filesystem>

#include "redrive/recording/core/recording.h"

namespace redrive::waymo {

bool looks_like(const std::filesystem::path& root);
/// Reads everything but images and range images, which are read in the file when they are asked
/// for.
Recording open(const std::filesystem::path& root, PoseSource source);

}  // namespace redrive::waymo
