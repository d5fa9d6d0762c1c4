// SPDX-License-Identifier: Apache-2.0
// Intervals that tile a ray, coarse to fine (Barron et al., "Mip-NeRF 360", CVPR 2022, section 3):
// first uniform in a warped distance, then PDF sampling of the weights that a proposal field gave
// to the intervals of the iteration before. For one ray.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "redrive/base/rng.h"
#include "redrive/field/contraction.h"

namespace redrive {

/// Spacing of a ray: distances are uniform in s(t) = t / (t + half_m), so that half of them lie
/// within half_m (Tonderski et al., "NeuRAD", 2024, with 20 m). half_m = +infinity: uniform in t.
/// Metres, 0 <= near_m <= far_m < infinity, half_m > 0.
struct RaySpacing {
  float near_m = 0, far_m = 0, half_m = 0;

  float distance(float u) const {  ///< u in [0, 1]: from near_m to far_m
    if (std::isinf(half_m)) return near_m + u * (far_m - near_m);
    const float first = near_m / (near_m + half_m), last = far_m / (far_m + half_m),
                s = first + u * (last - first);
    return half_m * s / (1 - s);
  }
};

/// Uniform sampling: writes edges [n + 1] of n >= 1 intervals, uniform in s. With jitter all edges
/// but the outer two are shifted by one random fraction of an interval, -1/2..1/2: the edges stay
/// ascending, and the interval that holds a distance is uniformly random.
inline void uniform_edges(const RaySpacing& spacing, int n, bool jitter, std::uint64_t key,
                          std::uint64_t ray, float* edges) {
  const float shift = jitter ? random_unit(key, ray) - 0.5f : 0.0f;
  for (int i = 0; i <= n; ++i) {
    const bool outer = i == 0 || i == n;
    edges[i] =
        spacing.distance((static_cast<float>(i) + (outer ? 0.0f : shift)) / static_cast<float>(n));
  }
}

/// PDF sampling: writes the edges out [to + 1] at the quantiles k / to of a histogram (edges [from
/// + 1], weights [from] >= 0), linear within an interval; the outer two edges stay. Histogram
/// padding: `padding` > 0 is the weight added to all intervals in equal parts, relative to the sum
/// of the weights, so that regions where the proposal is wrong still get samples. If all weights
/// are 0 the padding decides alone. With jitter the quantiles are (k + r) / to, r one random number
/// of the ray in -1/2..1/2. NaN weights give NaN edges.
inline void pdf_edges(const float* edges, const float* weights, int from, int to, float padding,
                      bool jitter, std::uint64_t key, std::uint64_t ray, float* out) {
  float total = 0;
  for (int i = 0; i < from; ++i) total += weights[i];
  // On an empty ray only the padding contributes.
  const float each = (total > 0 ? total : 1.0f) * padding / static_cast<float>(from);
  const float sum = total + each * static_cast<float>(from);
  const float shift = jitter ? random_unit(key, ray) - 0.5f : 0.0f;
  int i = 0;
  float before = 0, here = weights[0] + each;
  out[0] = edges[0];
  for (int k = 1; k < to; ++k) {
    const float target = sum * (static_cast<float>(k) + shift) / static_cast<float>(to);
    while (i + 1 < from && before + here < target) {
      before += here;
      here = weights[++i] + each;
    }
    const float part = (target - before) / here;
    out[k] = edges[i] + (part > 1 ? 1.0f : part) * (edges[i + 1] - edges[i]);  // NaN stays NaN
  }
  out[to] = edges[from];
}

/// Clips a ray's spacing to the scene: unchanged if the scene is unbounded, else the segment of
/// [near_m, far_m] within the scene's cube, uniform in distance. A ray that misses the cube gets
/// length 0, at near_m. origin [3] in metres, direction [3] a unit vector.
inline RaySpacing clip_to_scene(const RaySpacing& spacing, const Contraction& contraction,
                                const float origin[3], const float direction[3]) {
  if (contraction.unbounded) return spacing;
  float enter = spacing.near_m, leave = spacing.far_m;
  for (int k = 0; k < 3; ++k) {
    const float low = contraction.center[k] - contraction.half_m - origin[k],
                high = contraction.center[k] + contraction.half_m - origin[k];
    if (direction[k] == 0) {  // parallel to the slab: inside or outside throughout
      if (low > 0 || high < 0) leave = -1;
      continue;
    }
    const float a = low / direction[k], b = high / direction[k];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  if (!(enter < leave)) enter = leave = spacing.near_m;
  return {enter, leave, std::numeric_limits<float>::infinity()};
}

}  // namespace redrive
