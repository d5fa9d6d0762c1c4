// SPDX-License-Identifier: Apache-2.0
// Real spherical harmonics of degree 0..3 of a unit direction (Sloan, "Stupid Spherical Harmonics
// (SH) Tricks", 2008, appendix A2), on any scalar type: the view direction's encoding, as in
// instant-ngp. Order: degree l ascending, and m = -l..l within a degree. Orthonormal over the unit
// sphere.
#pragma once

#include "redrive/field/constants.h"

namespace redrive {

template <class T>
void spherical_harmonics(const T d[3], T out[kHarmonics]) {
  const T x = d[0], y = d[1], z = d[2], xx = x * x, yy = y * y, zz = z * z;
  out[0] = T(0.28209479177387814);
  out[1] = T(-0.48860251190291987) * y;
  out[2] = T(0.48860251190291987) * z;
  out[3] = T(-0.48860251190291987) * x;
  out[4] = T(1.0925484305920792) * x * y;
  out[5] = T(-1.0925484305920792) * y * z;
  out[6] = T(0.31539156525252005) * (T(3) * zz - T(1));
  out[7] = T(-1.0925484305920792) * x * z;
  out[8] = T(0.54627421529603959) * (xx - yy);
  out[9] = T(-0.59004358992664352) * y * (T(3) * xx - yy);
  out[10] = T(2.8906114426405538) * x * y * z;
  out[11] = T(-0.45704579946446572) * y * (T(5) * zz - T(1));
  out[12] = T(0.37317633259011540) * z * (T(5) * zz - T(3));
  out[13] = T(-0.45704579946446572) * x * (T(5) * zz - T(1));
  out[14] = T(1.4453057213202769) * z * (xx - yy);
  out[15] = T(-0.59004358992664352) * x * (xx - T(3) * yy);
}

}  // namespace redrive
