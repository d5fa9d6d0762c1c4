// SPDX-License-Identifier: Apache-2.0
// nuScenes (Caesar et al.: "nuScenes: A multimodal dataset for autonomous driving", CVPR 2020) as
// unpacked: tables in v1.0-mini, v1.0-trainval or v1.0-test; key frames in samples, the files
// between them in sweeps. A recording is one scene: v1.0-mini/scene-0061, a path that names no
// folder.
#pragma once

#include <filesystem>

#include "redrive/recording/core/recording.h"

namespace redrive::nuscenes {

/// Whether `root` or its parent holds tables, or holds a folder v1.0-* that does.
bool looks_like(const std::filesystem::path& root);
/// InputError as read_scene, and where the folder has tables of several versions.
Recording open(const std::filesystem::path& root, PoseSource source);

}  // namespace redrive::nuscenes
