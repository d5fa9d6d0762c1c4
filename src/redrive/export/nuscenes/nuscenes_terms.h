// SPDX-License-Identifier: Apache-2.0
// Names that nuScenes gives a drive's cameras and objects.
#pragma once

#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive::nuscenes {

/// Returns the channel of each camera: its own name where that is one of the six, else the one that
/// looks the same way to 30 degrees and is free, else CAM_NAME. Names are unique.
std::vector<std::string> channels_of(const std::vector<RecordedCamera>& cameras);

struct Term {
  const char *name, *description;
};
/// Returns the 23 categories, and the attributes, in the data set's order.
const std::vector<Term>& categories();
const std::vector<Term>& attributes();

/// Returns the category of a type in any data set's words; the type itself where none fits.
std::string category_of(const std::string& type);

/// Returns the attribute of a moving object of a category, "vehicle.moving"; empty: there is none.
std::string moving_attribute(const std::string& category);

}  // namespace redrive::nuscenes
