// SPDX-License-Identifier: Apache-2.0
// Sparsity regulariser of the density along one ray, value and derivative together.
#pragma once

#include <cmath>

namespace redrive {

///   L = sum over intervals of log(1 + x_i), x_i = density_i * length_i
/// after the sparsity loss of Hedman et al., "Baking Neural Radiance Fields for Real-Time View
/// Synthesis", ICCV 2021 (eq. 6), with the optical depth x_i instead of the squared density, so
/// that L does not depend on the unit of length. It removes density that no colour supports (behind
/// a lattice, below a car), which would otherwise remain from early steps. The logarithm
/// keeps it from making surfaces thin. edges [n + 1] ascending; density [n] >= 0. Adds scale * dL/d
/// density to d_density [n]; returns L (0 for no density; NaN stays NaN).
template <class T>
T sparsity_loss(const float* edges, const T* density, int n, T scale, T* d_density) {
  using std::log;
  T loss(0);
  for (int i = 0; i < n; ++i) {
    const T length(edges[i + 1] - edges[i]), more = T(1) + density[i] * length;
    loss += log(more);
    d_density[i] += scale * length / more;
  }
  return loss;
}

}  // namespace redrive
