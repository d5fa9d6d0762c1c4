// SPDX-License-Identifier: Apache-2.0
#include "redrive/sampling/hierarchical.h"

namespace redrive {

void hierarchical_ray(const float* coarse_t, const float* weights, int n, int extra, bool jitter, std::uint64_t key,
                      std::uint64_t first_index, float* t, float* dt) {
  const auto midpoint = [&](int i) { return 0.5 * (double(coarse_t[i]) + double(coarse_t[i + 1])); };
  const auto mass = [&](int i) { return double(weights[i]) + 1e-5; };
  double total = 0;
  for (int i = 1; i <= n - 2; ++i) total += mass(i);

  // The new samples ascend with k; they wait in the tail of t for the merge.
  float* fine = t + n;
  int interval = 1;
  double below = 0;  // mass of the intervals before this one
  for (int k = 0; k < extra; ++k) {
    const double u = (k + (jitter ? double(random_unit(key, first_index + k)) : 0.5)) / extra * total;
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
