// SPDX-License-Identifier: Apache-2.0
// The unbounded world in the unit cube (Barron et al., "Mip-NeRF 360", 2022, eq. 10, with the
// maximum norm as NeuRAD has it): with u = (x - center) / half_m and m = max |u_k|,  y = u inside
// the near region (m <= 1), (2 - 1/m) u/m beyond it, so that infinity lies at |y| = 2;  unit = (y +
// 2) / 4. A bounded scene (objects, rooms) has its near region alone: unit = (u + 1) / 2.
#pragma once

#include <array>
#include <cmath>

#include "redrive/base/host_device.h"

namespace redrive {

struct Contraction {
  std::array<float, 3> center{};  ///< world, metres
  float half_m = 1;               ///< half the side of the near region, a cube
  bool unbounded = true;

  bool operator==(const Contraction&) const = default;
};

/// Position in the unit cube; also works on dual numbers. Returns the cube root of the map's volume
/// factor, which turns the standard deviation of a sample's volume in metres into the unit cube's.
template <class T>
REDRIVE_HD T contract(const Contraction& contraction, const T world[3], T unit[3]) {
  using std::abs;
  using std::cbrt;
  T u[3], m(0);
  for (int k = 0; k < 3; ++k) {
    u[k] = (world[k] - T(contraction.center[k])) / T(contraction.half_m);
    if (abs(u[k]) > m) m = abs(u[k]);
  }
  if (!contraction.unbounded) {
    for (int k = 0; k < 3; ++k) unit[k] = (u[k] + T(1)) * T(0.5);
    return T(0.5 / contraction.half_m);
  }
  const bool beyond = m > T(1);
  const T shrink = beyond ? (T(2) - T(1) / m) / m : T(1);
  for (int k = 0; k < 3; ++k) unit[k] = (u[k] * shrink + T(2)) * T(0.25);
  // Along the radius by 1/m^2, across it by `shrink`, twice.
  double factor = 1;
  if (beyond) {
    double along = 0;
    if constexpr (requires { m.value; })
      along = m.value;
    else
      along = m;
    const double across = (2 - 1 / along) / along;
    factor = std::cbrt(across * across / (along * along));
  }
  return T(0.25 / contraction.half_m * factor);
}

/// d_world from d_unit, the derivative of contract's position alone: footprints are taken as they
/// are.
template <class T>
REDRIVE_HD void contract_adjoint(const Contraction& contraction, const T world[3],
                                 const T d_unit[3], T d_world[3]) {
  const T inverse = T(1) / T(contraction.half_m);
  T u[3], m(0);
  int largest = 0;
  for (int k = 0; k < 3; ++k) {
    u[k] = (world[k] - T(contraction.center[k])) * inverse;
    const T size = u[k] < T(0) ? -u[k] : u[k];
    if (size > m) {
      m = size;
      largest = k;
    }
  }
  const bool beyond = contraction.unbounded && m > T(1);
  const T scale = contraction.unbounded ? T(0.25) * inverse : T(0.5) * inverse;
  // unit = (u s(m) + 2) / 4 with s = (2 - 1/m) / m, ds/dm = 2 (1/m - 1) / m^2
  const T shrink = beyond ? (T(2) - T(1) / m) / m : T(1);
  for (int k = 0; k < 3; ++k) d_world[k] = scale * shrink * d_unit[k];
  if (!beyond) return;
  const T slope = T(2) * (T(1) / m - T(1)) / (m * m),
          along = u[0] * d_unit[0] + u[1] * d_unit[1] + u[2] * d_unit[2];
  d_world[largest] += scale * (u[largest] < T(0) ? -slope : slope) * along;
}

}  // namespace redrive
