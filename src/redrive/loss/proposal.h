// SPDX-License-Identifier: Apache-2.0
// What the proposals learn from; scalar, one ray, value and derivative together.
#pragma once

namespace redrive {

/// The proposal must be an upper envelope of the field's weights (Barron et al., "Mip-NeRF 360", 2022, eq. 13): with bound_i the sum
/// of the proposal's weights whose intervals overlap interval i,
///   L = sum_i max(0, w_i - bound_i)^2 / (w_i + 1e-7).
/// The field's weights count as constants. Adds scale * dL/d proposal weight to d_proposal [m]; returns L.
/// edges [n + 1], weights [n]; proposal_edges [m + 1], proposal [m]; both tile the same ray.
template <class T>
T interlevel_loss(const float* edges, const T* weights, int n, const float* proposal_edges, const T* proposal, int m,
                  T scale, T* d_proposal) {
  T loss(0);
  int first = 0;
  for (int i = 0; i < n; ++i) {
    while (first + 1 < m && proposal_edges[first + 1] <= edges[i]) ++first;
    int last = first;
    T bound = proposal[first];
    while (last + 1 < m && proposal_edges[last + 1] < edges[i + 1]) bound += proposal[++last];
    const T lacking = weights[i] - bound;
    if (lacking <= T(0)) continue;  // NaN goes on into the loss
    const T share = lacking / (weights[i] + T(1e-7));
    loss += lacking * share;
    for (int j = first; j <= last; ++j) d_proposal[j] -= T(2) * scale * share;
  }
  return loss;
}

}  // namespace redrive
