// SPDX-License-Identifier: Apache-2.0
// The JPEG codec, by libjpeg-turbo.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "redrive/image/image.h"

namespace redrive {

bool is_jpeg(std::string_view bytes);

/// Decodes by the accurate integer DCT, with chroma interpolated between its samples. `path` names
/// the file in errors. InputError where libjpeg-turbo reports an error or a warning.
Image8 decode_jpeg(std::string_view bytes, const std::filesystem::path& path);

/// Encodes by the accurate integer DCT, 4:2:0; alpha is not kept. `quality` 1..100.
std::string encode_jpeg(const Image8& image, int quality);

}  // namespace redrive
