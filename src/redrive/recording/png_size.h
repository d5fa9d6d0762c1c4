// SPDX-License-Identifier: Apache-2.0
// The size of an image from its file's header, for formats whose calibration lacks it, and for
// those with a file of rectified images' sizes.
#pragma once

#include <filesystem>
#include <optional>

namespace redrive {

struct ImageSize {
  int width = 0, height = 0;
};

/// Returns the size of a PNG from its first chunk; nothing for any other file. InputError for sizes
/// outside 1 to 65536.
std::optional<ImageSize> png_size(const std::filesystem::path& path);

/// InputError unless the image, if it is a PNG, has the size in `calibration`, a file.
void check_png_size(const std::filesystem::path& image, ImageSize expected,
                    const std::filesystem::path& calibration);

}  // namespace redrive
