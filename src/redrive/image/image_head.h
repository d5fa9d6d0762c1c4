// SPDX-License-Identifier: Apache-2.0
// Reads size, channels and EXIF focal length from the head of an image file.
#pragma once

#include <filesystem>
#include <optional>
#include <string_view>

namespace redrive {

struct ImageHead {
  int width = 0, height = 0;
  bool grey = false;  ///< one channel, apart from alpha
  /// FocalLengthIn35mmFilm of EXIF, mm: of a lens that sees as much on film of 36 x 24 mm.
  std::optional<double> film_focal_mm;

  /// The focal length that it stands for, by the diagonal of the image.
  std::optional<double> focal_px() const;
};

/// Returns what the first bytes of a PNG or JPEG say; nothing for other files and damaged ones.
std::optional<ImageHead> parse_image_head(std::string_view bytes);

/// As parse_image_head, of the first 4 KB of a file, and of 256 KB where these are not enough.
std::optional<ImageHead> read_image_head(const std::filesystem::path& path);

/// Whether a PNG or JPEG ends with its end marker, so it was not cut; false for other files.
bool has_image_end(const std::filesystem::path& path);

}  // namespace redrive
