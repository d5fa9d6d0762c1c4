// SPDX-License-Identifier: Apache-2.0
// Losses that train the proposal field, for one ray, value and derivative together.
#pragma once

namespace redrive {

/// Interlevel loss (Barron et al., "Mip-NeRF 360", CVPR 2022, eq. 13): the proposal's weights must
/// be an upper envelope of the field's. With bound_i the sum of the proposal's weights whose
/// intervals overlap interval i,
///   L = sum_i max(0, w_i - bound_i)^2 / (w_i + 1e-7).
/// The field's weights are constants. edges [n + 1], weights [n]; proposal_edges [m + 1], proposal
/// [m]; both tile the same ray. Adds scale * dL/d proposal to d_proposal [m]; returns L.
template <class T>
T interlevel_loss(const float* edges, const T* weights, int n, const float* proposal_edges,
                  const T* proposal, int m, T scale, T* d_proposal) {
  T loss(0);
  int first = 0;
  for (int i = 0; i < n; ++i) {
    while (first + 1 < m && proposal_edges[first + 1] <= edges[i]) ++first;
    int last = first;
    T bound = proposal[first];
    while (last + 1 < m && proposal_edges[last + 1] < edges[i + 1]) bound += proposal[++last];
    const T lacking = weights[i] - bound;
    if (lacking <= T(0)) continue;  // NaN reaches the loss
    const T share = lacking / (weights[i] + T(1e-7));
    loss += lacking * share;
    for (int j = first; j <= last; ++j) d_proposal[j] -= T(2) * scale * share;
  }
  return loss;
}

/// Opacity loss: (sum of the proposal's weights - sum of the field's)^2. The envelope may be too
/// wide, but its opacity has to match: nothing else would remove weights that the proposal has in
/// empty space. Adds scale * dL/d proposal to d_proposal [m]; returns L.
template <class T>
T opacity_loss(const T* weights, int n, const T* proposal, int m, T scale, T* d_proposal) {
  T more(0);
  for (int j = 0; j < m; ++j) more += proposal[j];
  for (int i = 0; i < n; ++i) more -= weights[i];
  for (int j = 0; j < m; ++j) d_proposal[j] += T(2) * scale * more;
  return more * more;
}

/// Returns interlevel_loss + opacity_weight * opacity_loss; arguments as interlevel_loss.
template <class T>
T proposal_loss(const float* edges, const T* weights, int n, const float* proposal_edges,
                const T* proposal, int m, double opacity_weight, T scale, T* d_proposal) {
  return interlevel_loss(edges, weights, n, proposal_edges, proposal, m, scale, d_proposal) +
         T(opacity_weight) *
             opacity_loss(weights, n, proposal, m, T(opacity_weight) * scale, d_proposal);
}

}  // namespace redrive
