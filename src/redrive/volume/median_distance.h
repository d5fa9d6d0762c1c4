// SPDX-License-Identifier: Apache-2.0
// Median distance of a ray: the depth that is shown and scored.
#pragma once

namespace redrive {

/// Returns the distance in metres at which the accumulated weight reaches half of the opacity,
/// linear within the interval. Unlike the mean it does not depend on the distance of weights behind
/// it. Returns the far edge if all weights are 0. edges [n + 1] in metres, weights [n], opacity
/// their sum.
inline float median_distance(const float* edges, const float* weights, int n, float opacity) {
  float before = 0;
  for (int i = 0; i < n; ++i) {
    if (before + weights[i] >= 0.5f * opacity && weights[i] > 0)
      return edges[i] + (0.5f * opacity - before) / weights[i] * (edges[i + 1] - edges[i]);
    before += weights[i];
  }
  return edges[n];
}

}  // namespace redrive
