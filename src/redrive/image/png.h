// SPDX-License-Identifier: Apache-2.0
// The PNG codec, by libpng.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "redrive/image/image.h"

namespace redrive {

bool is_png(std::string_view bytes);

/// `path` names the file in errors. InputError where libpng reports an error; its warnings, about
/// colour profiles above all, are ignored. See read_image for grey, palettes and 16 bits.
Image8 decode_png(std::string_view bytes, const std::filesystem::path& path);
Image16 decode_png16(std::string_view bytes, const std::filesystem::path& path);

/// Encodes RGB, or RGBA where the image has alpha.
std::string encode_png(const Image8& image);
std::string encode_png16(const Image16& image);

}  // namespace redrive
