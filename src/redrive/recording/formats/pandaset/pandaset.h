// SPDX-License-Identifier: Apache-2.0
// PandaSet (Xiao et al.: "PandaSet: Advanced Sensor Suite Dataset for Autonomous Driving", ITSC
// 2021), the folder of a sequence: camera/<name> and lidar with poses.json and timestamps.json,
// scans and annotations/cuboids as pickles of pandas, NN.pkl.gz.
#pragma once

#include <filesystem>

#include "redrive/recording/core/recording.h"

namespace redrive::pandaset {

bool looks_like(const std::filesystem::path& root);
/// Scans and cuboids are read when they are asked for. InputError where poses or times of the first
/// camera, or intrinsics, are missing or malformed.
Recording open(const std::filesystem::path& root, PoseSource source);

}  // namespace redrive::pandaset
