// SPDX-License-Identifier: Apache-2.0
// Where a ray ends, as a picture shows it.
#pragma once

#include "redrive/base/host_device.h"

namespace redrive {

/// Where half of what a ray meets lies before: unlike the mean it does not care how far behind it
/// the rest is. Within an interval linear; the end of a ray that meets nothing. edges [n + 1] in
/// metres, weights [n], opacity their sum.
REDRIVE_HD inline float median_distance(const float* edges, const float* weights, int n,
                                        float opacity) {
  float before = 0;
  for (int i = 0; i < n; ++i) {
    if (before + weights[i] >= 0.5f * opacity && weights[i] > 0)
      return edges[i] + (0.5f * opacity - before) / weights[i] * (edges[i + 1] - edges[i]);
    before += weights[i];
  }
  return edges[n];
}

}  // namespace redrive
