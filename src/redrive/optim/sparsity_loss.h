// SPDX-License-Identifier: Apache-2.0
// What matter costs, so that there is none where no colour speaks for it; scalar, one ray, value
// and derivative together.
#pragma once

#include <cmath>

#include "redrive/base/host_device.h"

namespace redrive {

/// What is seen from a few views alone, or by nobody any more, keeps whatever matter once was put
/// there: behind a lattice, below a car.
///   L = sum over intervals of log(1 + x_i), x_i = density_i * length_i
/// (after the sparsity loss of Hedman et al., "Baking Neural Radiance Fields for Real-Time View
/// Synthesis", 2021, which has the squared density; here of the optical depth, so that the unit of
/// length does not count). Rising ever slower, it does not ask surfaces to be thin. edges [n + 1],
/// ascending; density >= 0. Adds scale * dL/d density to d_density [n]; returns L.
template <class T>
REDRIVE_HD T sparsity_loss(const float* edges, const T* density, int n, T scale, T* d_density) {
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
