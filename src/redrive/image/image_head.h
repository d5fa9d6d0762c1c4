// SPDX-License-Identifier: Apache-2.0
// Reads size, channels and EXIF focal length from the head of an image file.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string_view>

namespace redrive {

struct ImageHead {
  int width = 0, height = 0;
  bool grey = false;  ///< one channel, apart from alpha
  /// FocalLengthIn35mmFilm of EXIF, mm: focal length with the same view on film of 36 x 24 mm.
  std::optional<double> film_focal_mm;

  /// Returns the focal length in pixels, from the image's diagonal.
  std::optional<double> focal_px() const;
};

/// Returns what the first bytes of a PNG or JPEG contain; nothing for other files and damaged ones.
std::optional<ImageHead> parse_image_head(std::string_view bytes);

/// Like parse_image_head, for the first 4 KB of a file, or 256 KB where these are not enough.
std::optional<ImageHead> read_image_head(const std::filesystem::path& path);

/// What both ends of an image file tell.
struct ImageFileEnds {
  std::uint64_t bytes = 0;  ///< size of the file
  std::optional<ImageHead> head;
  /// A PNG or JPEG has its end marker, so it was not cut; false for other files. True in a
  /// container, which knows the file's length.
  bool has_end = false;
};

/// Opens the file once. InputError if it is missing, unreadable or no regular file.
ImageFileEnds read_image_ends(const std::filesystem::path& path);

}  // namespace redrive
