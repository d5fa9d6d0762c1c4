// SPDX-License-Identifier: Apache-2.0
// Writes OpenEXR images by tinyexr, which a build may lack.
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>

namespace redrive {

/// Returns why this program cannot write EXR, naming what is missing; nothing where it can.
std::optional<std::string> exr_obstacle();

/// Writes one channel `Z` of 32-bit floats [height, width], ZIP compressed, whole or not at all.
/// There must be no exr_obstacle(). IoError.
void write_exr(const std::filesystem::path& file, int width, int height,
               std::span<const float> values);

}  // namespace redrive
