// SPDX-License-Identifier: Apache-2.0
// Samples of one ray as in NeRF (Mildenhall et al. 2020): stratified (eq. 2) and hierarchical
// (section 5.2, inverse transform sampling of the coarse weights).
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

#include "redrive/base/rng.h"

namespace redrive {

/// Writes t [n], one sample in each of n equal bins of [near_m, far_m], in metres, and dt_i =
/// t_{i+1} - t_i, the last +infinity. With jitter the position in bin i is random_unit(key,
/// first_index + i), else 1/2. n >= 1.
inline void stratified_ray(int n, float near_m, float far_m, bool jitter, std::uint64_t key,
                           std::uint64_t first_index, float* t, float* dt) {
  const float bin = (far_m - near_m) / static_cast<float>(n);
  for (int i = 0; i < n; ++i)
    t[i] = near_m +
           bin * (static_cast<float>(i) + (jitter ? random_unit(key, first_index + i) : 0.5f));
  for (int i = 0; i + 1 < n; ++i) dt[i] = t[i + 1] - t[i];
  dt[n - 1] = std::numeric_limits<float>::infinity();
}

/// Draws `extra` samples from the piecewise-constant PDF over the intervals between the midpoints
/// of coarse_t [n], interval i (1 <= i <= n - 2) with mass weights[i] + 1e-5 (as the paper's code),
/// and merges them with the coarse ones into t [n + extra], ascending; dt as in stratified_ray. t
/// must not overlap coarse_t. u_k = (k + r) / extra, r = random_unit(key, first_index + k) or 1/2:
/// stratified, so the inverse CDF is one forward walk; in double, since sums of small masses lose
/// digits in float. n >= 3. Non-finite weights give non-finite t.
inline void hierarchical_ray(const float* coarse_t, const float* weights, int n, int extra,
                             bool jitter, std::uint64_t key, std::uint64_t first_index, float* t,
                             float* dt) {
  const auto midpoint = [&](int i) {
    return 0.5 * (double(coarse_t[i]) + double(coarse_t[i + 1]));
  };
  const auto mass = [&](int i) { return double(weights[i]) + 1e-5; };
  double total = 0;
  for (int i = 1; i <= n - 2; ++i) total += mass(i);

  // The new samples ascend with k; they wait at the end of t for the merge.
  float* fine = t + n;
  int interval = 1;
  double below = 0;  // mass of the intervals before this one
  for (int k = 0; k < extra; ++k) {
    const double u =
        (k + (jitter ? double(random_unit(key, first_index + k)) : 0.5)) / extra * total;
    while (interval < n - 2 && below + mass(interval) <= u) below += mass(interval++);
    const double lower = midpoint(interval - 1), upper = midpoint(interval);
    // The clamp: `below` and `total` are rounded sums, so the fraction may pass 1 by an ulp.
    const double fraction = std::min((u - below) / mass(interval), 1.0);
    fine[k] = static_cast<float>(std::min(lower + fraction * (upper - lower), upper));
  }

  // In place: the merged prefix of length i + k never reaches fine[k] at n + k, because i <= n.
  int i = 0, k = 0;
  while (i < n) {
    if (k < extra && fine[k] < coarse_t[i]) {
      t[i + k] = fine[k];
      ++k;
    } else {
      t[i + k] = coarse_t[i];
      ++i;
    }
  }
  for (int j = 0; j + 1 < n + extra; ++j) dt[j] = t[j + 1] - t[j];
  dt[n + extra - 1] = std::numeric_limits<float>::infinity();
}

}  // namespace redrive
