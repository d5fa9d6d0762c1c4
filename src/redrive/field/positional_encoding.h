// SPDX-License-Identifier: Apache-2.0
// gamma of NeRF section 5.1, scalar; the kernels' oracle.
#pragma once

#include <cmath>

#include "redrive/base/host_device.h"

namespace redrive {

/// out[0..3+6*octaves): x y z, then per coordinate sin(2^l pi p), cos(2^l pi p) for l =
/// 0..octaves-1. p in [-1, 1] (any finite value is allowed; the period is 2).
template <class T>
void positional_encoding(const T point[3], int octaves, T* out) {
  using std::cos;
  using std::sin;
  for (int d = 0; d < 3; ++d) {
    out[d] = point[d];
    for (int l = 0; l < octaves; ++l) {
      const T angle = point[d] * T(std::ldexp(3.14159265358979323846, l));
      out[3 + 2 * (d * octaves + l)] = sin(angle);
      out[3 + 2 * (d * octaves + l) + 1] = cos(angle);
    }
  }
}

/// The adjoint, from what positional_encoding gave, since (sin a)' = cos a and (cos a)' = -sin a
/// with a = 2^l pi p:
///   d_point = d_out of p + sum over l of 2^l pi (cos a d_sin - sin a d_cos), written.
template <class T>
REDRIVE_HD void positional_encoding_adjoint(const T* out, int octaves, const T* d_out,
                                            T d_point[3]) {
  for (int d = 0; d < 3; ++d) {
    d_point[d] = d_out[d];
    for (int l = 0; l < octaves; ++l) {
      const int sine = 3 + 2 * (d * octaves + l), cosine = sine + 1;
      d_point[d] += T(std::ldexp(3.14159265358979323846, l)) *
                    (out[cosine] * d_out[sine] - out[sine] * d_out[cosine]);
    }
  }
}

}  // namespace redrive
