// SPDX-License-Identifier: Apache-2.0
// Sizes of images from their files' headers, for formats whose calibration lacks them or repeats
// them.
#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

struct ImageSize {
  int width = 0, height = 0;
  bool operator==(const ImageSize&) const = default;
};

/// Returns the size of a PNG or a JPEG from its header; nothing for any other file, for one that is
/// damaged there, and for more than 65536 pixels a side.
std::optional<ImageSize> image_size(const std::filesystem::path& path);

/// Returns the most frequent size of a few of the images, spread over them; nothing where none is
/// known.
std::optional<ImageSize> usual_image_size(const std::vector<ImageFile>& images);

}  // namespace redrive
