// SPDX-License-Identifier: Apache-2.0
// Volume rendering weights of a ray's intervals (volume/composite.h) from densities alone, and the
// adjoint, on any scalar type:
//   w_i = T_i (1 - exp(-density_i dt_i)), T_i = exp(-sum_{j<i} density_j dt_j).
#pragma once

#include <cmath>

namespace redrive {

/// Writes weights [n], in [0, 1]. edges [n + 1] ascending, metres; density [n] >= 0, 1/m; intervals
/// of length 0 get weight 0.
template <class T>
void ray_weights(const float* edges, const T* density, int n, T* weights) {
  using std::exp;
  using std::expm1;
  T transmittance(1);
  for (int i = 0; i < n; ++i) {
    const T depth = density[i] * T(edges[i + 1] - edges[i]);
    weights[i] = transmittance * -expm1(-depth);
    transmittance *= exp(-depth);
  }
}

/// Writes d_density [n] from the weights that ray_weights returned:
///   d density_i = dt_i (T_{i+1} d_w_i - sum_{j>i} w_j d_w_j).
/// T is recomputed, since T_{i+1} = 1 - sum_{j<=i} w_j would cancel.
template <class T>
void ray_weights_adjoint(const float* edges, const T* density, int n, const T* weights,
                         const T* d_weights, T* d_density) {
  using std::exp;
  T transmittance(1), behind(0);
  for (int i = 0; i < n; ++i) {
    transmittance *= exp(-density[i] * T(edges[i + 1] - edges[i]));
    d_density[i] = transmittance * d_weights[i];
  }
  for (int i = n - 1; i >= 0; --i) {
    d_density[i] = T(edges[i + 1] - edges[i]) * (d_density[i] - behind);
    behind += weights[i] * d_weights[i];
  }
}

}  // namespace redrive
