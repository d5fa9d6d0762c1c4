// SPDX-License-Identifier: Apache-2.0
// Sequences of NVIDIA's NCore, version 4: a folder with stores NAME.ncore4[-GROUP].zarr.itar, or
// .zarr folders, and the JSON file that lists them. docs/recordings.md has conventions and sources.
#pragma once

#include <filesystem>

#include "redrive/recording/core/recording.h"

namespace redrive::ncore {

bool looks_like(const std::filesystem::path& root);
/// Reads poses, calibration, times and boxes; images and scans are read in the stores when they are
/// asked for.
Recording open(const std::filesystem::path& root, PoseSource source);

}  // namespace redrive::ncore
