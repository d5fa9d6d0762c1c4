// SPDX-License-Identifier: Apache-2.0
// Positional encoding gamma (Mildenhall et al., ECCV 2020, section 5.1, eq. 4), for one point.
#pragma once

#include <cmath>

namespace redrive {

/// Writes out[3 + 6 * octaves]: x, y, z, then for each coordinate p
///   sin(2^0 pi p), cos(2^0 pi p), ..., sin(2^(octaves-1) pi p), cos(2^(octaves-1) pi p).
/// p is meant to lie in [-1, 1]; any finite value is allowed, the sines have period 2. Infinity
/// gives NaN.
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

/// Writes d_point from the output of positional_encoding and its adjoint d_out:
///   d_point = d_p + sum over l of 2^l pi (cos_l d_sin_l - sin_l d_cos_l).
template <class T>
void positional_encoding_adjoint(const T* out, int octaves, const T* d_out, T d_point[3]) {
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
