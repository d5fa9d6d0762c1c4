// SPDX-License-Identifier: Apache-2.0
// What a LiDAR ray says of the weights along it; scalar, one ray, value and derivative together.
#pragma once

#include <cmath>

#include "redrive/base/host_device.h"

namespace redrive {

/// A return at `range` means: free before, a surface there, nothing known behind. The line-of-sight
/// terms of Rematas et al., "Urban Radiance Fields" (2022), eq. 12 to 14, as one sum over
/// intervals: with g_i the part of a normal distribution around the range, of standard deviation
/// `spread`, that lies in interval i,
///   L = sum over intervals that begin before range + 3 spread of (w_i - g_i)^2.
/// edges [n + 1] and range, spread > 0 in metres. Writes scale * dL/dw to d_weights [n]; returns L.
template <class T>
REDRIVE_HD T range_loss(const float* edges, const T* weights, int n, float range, float spread,
                        T scale, T* d_weights) {
  const auto below = [&](float t) {
    return 0.5f * std::erfc((range - t) / (1.41421356f * spread));
  };
  T loss(0);
  float before = below(edges[0]);
  for (int i = 0; i < n; ++i) {
    if (edges[i] >= range + 3 * spread) {
      d_weights[i] = T(0);
      continue;
    }
    const float until = below(edges[i + 1]);
    const T over = weights[i] - T(until - before);
    loss += over * over;
    d_weights[i] = T(2) * scale * over;
    before = until;
  }
  return loss;
}

}  // namespace redrive
