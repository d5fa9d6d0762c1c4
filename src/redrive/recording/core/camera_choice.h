// SPDX-License-Identifier: Apache-2.0
// Selects the cameras of a recording that are used.
#pragma once

#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Returns the camera of that name. UsageError for --cameras, with the existing names.
const RecordedCamera& named_camera(const Recording& recording, const std::string& name);

/// Keeps only the named cameras; all of them where no name is given. UsageError as named_camera,
/// and for a name given twice.
void keep_cameras(const std::vector<std::string>& names, Recording* recording);

/// Names of the cameras whose first image is grey, by its file's head; of rigs also by its pixels.
std::vector<std::string> grey_cameras(const Recording& recording);

}  // namespace redrive
