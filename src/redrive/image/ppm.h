// SPDX-License-Identifier: Apache-2.0
// Plain pixels behind a short head: PPM (P6) and PGM (P5) of Netpbm with 8 bits a channel.
#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "redrive/image/image.h"

namespace redrive {

struct PpmHead {
  int width = 0, height = 0, channels = 0;  ///< 1 to 65536; 3 or 1
  std::size_t size = 0;                     ///< bytes of the head

  std::size_t pixel_bytes() const {
    return static_cast<std::size_t>(width) * static_cast<std::size_t>(height) *
           static_cast<std::size_t>(channels);
  }
};

/// Nothing for other files, more than 8 bits, comments, more than kMaxImagePixels.
std::optional<PpmHead> parse_ppm_head(std::string_view bytes);
std::string ppm_head_text(int width, int height, int channels);

/// Grey becomes RGB. `path` names the file in errors. InputError: cut off.
Image8 decode_ppm(std::string_view bytes, const std::filesystem::path& path);

}  // namespace redrive
