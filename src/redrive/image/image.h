// SPDX-License-Identifier: Apache-2.0
// Images in memory.
#pragma once

#include <cstdint>
#include <vector>

namespace redrive {

/// RGB with 8 bits a channel, row-major.
struct Image8 {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgb;    ///< [height, width, 3]
  std::vector<std::uint8_t> alpha;  ///< [height, width], 255 is opaque; empty: all pixels are
  std::vector<std::uint8_t> used;   ///< [height, width], 0 is masked; empty: no pixel is
};

/// One channel of 16 bits, row-major, e.g. depth in millimetres.
struct Image16 {
  int width = 0, height = 0;
  std::vector<std::uint16_t> values;  ///< [height, width]
};

/// Maximum number of pixels of an image that is read. A file of a few bytes must not make the
/// program take all memory.
constexpr std::int64_t kMaxImagePixels = std::int64_t{1} << 28;

}  // namespace redrive
