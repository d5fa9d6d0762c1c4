// SPDX-License-Identifier: Apache-2.0
// The size of an image from its file's header, for formats whose calibration lacks it.
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

}  // namespace redrive
