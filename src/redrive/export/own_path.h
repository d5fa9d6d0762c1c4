// SPDX-License-Identifier: Apache-2.0
// A way of one's own for the car, as places over time.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include "redrive/scene/scene.h"

namespace redrive {

/// Returns the body's poses at the scene's frames, until the file ends: a CSV with the columns t_s,
/// x_m and y_m in any order, seconds after the first frame and metres in the scene's world.
/// The way between its rows is straight. The car looks along it; a standing one looks as before.
/// The nearest driven pose gives height and tilt. InputError names line and column; the first row
/// must be at 0 or before.
std::vector<FramePose> poses_on_own_path(std::string_view text, const std::filesystem::path& file,
                                         const Scene& scene);

}  // namespace redrive
