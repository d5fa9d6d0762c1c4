// SPDX-License-Identifier: Apache-2.0
// LiDAR supervision of the weights along one ray, value and derivative together.
#pragma once

#include <cmath>

namespace redrive {

/// Line-of-sight loss (Rematas et al., "Urban Radiance Fields", CVPR 2022, eq. 12 to 14) as one sum
/// over intervals: with g_i the mass of a normal distribution around `range`, standard deviation
/// `spread`, in interval i,
///   L = sum over intervals that begin before range + 3 spread of (w_i - g_i)^2:
/// empty before the return, a surface there, unknown behind it. edges [n + 1], range and spread > 0
/// in metres, weights [n]. Writes scale * dL/dw to d_weights [n]; returns L.
template <class T>
T range_loss(const float* edges, const T* weights, int n, float range, float spread, T scale,
             T* d_weights) {
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
