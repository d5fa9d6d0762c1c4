// SPDX-License-Identifier: Apache-2.0
// Names that Argoverse 2 gives a drive's cameras and objects.
#pragma once

#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive::argoverse2 {

/// Returns the name of each camera (export/rig_names.h): a ring camera's, or its own.
std::vector<std::string> ring_names(const std::vector<RecordedCamera>& cameras);

/// Returns the category of a type in any data set's words; the type itself where none fits.
std::string category_of(const std::string& type);

/// Returns an object's track_uuid.
std::string track_uuid(std::int64_t object_id);

}  // namespace redrive::argoverse2
