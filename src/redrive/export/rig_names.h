// SPDX-License-Identifier: Apache-2.0
// Names that a data set's rig gives the cameras of another rig.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

/// A camera of a data set's rig.
struct RigPlace {
  const char* name;
  double heading_deg;  ///< to the left of ahead
};

/// Returns the name of each camera: its own where that is one of the rig's, else the one that looks
/// the same way to 30 degrees and is free, else `own_name(name)`. Names are unique.
std::vector<std::string> names_in_rig(
    const std::vector<RecordedCamera>& cameras, std::span<const RigPlace> rig,
    const std::function<std::string(const std::string&)>& own_name);

}  // namespace redrive
