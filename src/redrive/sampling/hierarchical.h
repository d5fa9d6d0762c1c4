// SPDX-License-Identifier: Apache-2.0
// Samples of one ray, scalar: stratified (NeRF eq. 2) and hierarchical (section 5.2: inverse transform sampling of the
// coarse weights). Kernels call or vectorise these.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

#include "redrive/base/rng.h"

namespace redrive {

/// t_i in bin i of `n` equal bins of [near_m, far_m]; dt_i = t_{i+1} - t_i, the last +infinity.
inline void stratified_ray(int n, float near_m, float far_m, bool jitter, std::uint64_t key, std::uint64_t first_index,
                           float* t, float* dt) {
  const float bin = (far_m - near_m) / static_cast<float>(n);
  for (int i = 0; i < n; ++i)
    t[i] = near_m + bin * (static_cast<float>(i) + (jitter ? random_unit(key, first_index + i) : 0.5f));
  for (int i = 0; i + 1 < n; ++i) dt[i] = t[i + 1] - t[i];
  dt[n - 1] = std::numeric_limits<float>::infinity();
}

/// Draws `extra` t from the piecewise-constant density over the intervals between the midpoints of coarse t, interval i
/// (1 <= i <= n-2) having mass weights[i] + 1e-5 (the paper's code), and merges them with the coarse t into
/// t[0 .. n + extra), ascending; dt as above. t must not overlap coarse_t. u_k = (k + r) / extra with r = random_unit or 1/2: stratified, so the
/// inverse walks forward once; in double, as sums of small masses lose digits in float. n >= 3. Non-finite weights give
/// non-finite t.
void hierarchical_ray(const float* coarse_t, const float* weights, int n, int extra, bool jitter, std::uint64_t key,
                      std::uint64_t first_index, float* t, float* dt);

}  // namespace redrive
