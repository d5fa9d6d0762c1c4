// SPDX-License-Identifier: Apache-2.0
// Another path for the car of a drive.
#pragma once

#include <string>

#include "redrive/scene/scene.h"

namespace redrive {

/// Returns the scene with the body on another path: "drive", as driven; "sideways:METRES" to the
/// left in body axes; "speed:FACTOR" times as fast along the same way, ending where it ends; the
/// places of a .csv (export/own_path.h), ending with it; or the poses of a file
/// (recording/formats/egomotion_json.h), which must hold the scene's frames. Moving objects keep
/// their times. UsageError, also more than 1 km from the driven way; InputError.
Scene scene_on_path(const Scene& scene, const std::string& path);
/// Throws UsageError where `path` is neither a word nor a number that scene_on_path takes, nor a
/// file.
void check_path(const std::string& path);

}  // namespace redrive
