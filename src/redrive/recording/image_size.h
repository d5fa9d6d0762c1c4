// SPDX-License-Identifier: Apache-2.0
// Sizes of images from their files' headers, for formats whose calibration lacks them or repeats
// them.
#pragma once

#include <filesystem>
#include <optional>

namespace redrive {

struct ImageSize {
  int width = 0, height = 0;
  bool operator==(const ImageSize&) const = default;
};

/// Returns the size of a PNG or a JPEG from its header; nothing for any other file, and for a JPEG
/// that ends before its size. InputError for sizes outside 1 to 65536.
std::optional<ImageSize> image_size(const std::filesystem::path& path);

/// InputError unless the image, if its size is known, has the size in `calibration`, a file.
void check_image_size(const std::filesystem::path& image, ImageSize expected,
                      const std::filesystem::path& calibration);

}  // namespace redrive
