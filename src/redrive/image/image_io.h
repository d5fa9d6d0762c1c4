// SPDX-License-Identifier: Apache-2.0
// Reads and writes image files: PNG by libpng, JPEG by libjpeg-turbo.
#pragma once

#include <filesystem>
#include <string>

#include "redrive/image/image.h"

namespace redrive {

/// Reads a JPEG or PNG file, recognised by its first bytes, without changes: EXIF orientation and
/// colour profiles are not applied, colours are not multiplied by alpha. Grey becomes RGB, a
/// palette its colours, 16 bits round(x / 257), a transparent colour (tRNS) alpha. InputError:
/// missing, not an image, truncated, damaged, CMYK, more than kMaxImagePixels.
Image8 read_image(const std::filesystem::path& path);
/// Reads a PNG of one channel with 16 bits. InputError as read_image.
Image16 read_png16(const std::filesystem::path& path);

/// Writes PNG (with alpha where the image has it) or JPEG (quality 92, without alpha) by the file's
/// extension, whole or not at all. UsageError for another extension, IoError.
void write_image(const std::filesystem::path& path, const Image8& image);
/// Writes a PNG of one channel with 16 bits, whole or not at all. UsageError, IoError.
void write_png16(const std::filesystem::path& path, const Image16& image);

/// "640 x 480".
std::string size_text(int width, int height);

}  // namespace redrive
