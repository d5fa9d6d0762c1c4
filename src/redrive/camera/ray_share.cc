// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/ray_share.h"

#include <algorithm>
#include <cstdio>

namespace redrive {

double percent_without_ray(const Camera& camera, int columns) {
  const int step = std::max(1, camera.width / columns);
  int all = 0, without = 0;
  for (int v = 0; v < camera.height; v += step)
    for (int u = 0; u < camera.width; u += step, ++all)
      without += !camera.unproject({double(u), double(v)});
  return 100.0 * without / std::max(1, all);
}

std::string without_ray_text(double percent) {
  char text[100];
  std::snprintf(text, sizeof text,
                "%.1f %% of the pixels lie outside the radius where the distortion is one-to-one",
                percent);
  return text;
}

}  // namespace redrive
