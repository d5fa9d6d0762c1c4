// SPDX-License-Identifier: Apache-2.0
// Images for tests.
#pragma once

#include <cstdint>

#include "redrive/image/image.h"

namespace redrive {

/// Returns an image whose colours vary smoothly, so that JPEG keeps them.
inline Image8 smooth_image(int width, int height) {
  Image8 image{width, height, {}};
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (const int value : {200 * x / width, 200 * y / height, 80})
        image.rgb.push_back(static_cast<std::uint8_t>(value));
  return image;
}

}  // namespace redrive
