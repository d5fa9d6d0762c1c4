// SPDX-License-Identifier: Apache-2.0
// The section on annotated objects of the page of inspect --report.
#pragma once

#include <filesystem>
#include <string>

#include "redrive/align/rig/rig_images.h"

namespace redrive {

/// Returns a table of the objects' tracks, an image of each camera with their boxes, and the tracks
/// from above; empty where the recording has no boxes. Writes folder/objects_<CAM>.jpg and
/// folder/figures/objects_above.png with its script. InputError as load_view; IoError.
std::string objects_section(const std::filesystem::path& folder, const Recording& recording,
                            const RigImages& images);

}  // namespace redrive
