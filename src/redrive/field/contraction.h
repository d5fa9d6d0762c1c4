// SPDX-License-Identifier: Apache-2.0
// Scene contraction: maps the world into the unit cube (Barron et al., "Mip-NeRF 360", CVPR 2022,
// eq. 10, with the maximum norm in place of the Euclidean one, as Tonderski et al., "NeuRAD",
// 2024). With u = (x - center) / half_m and m = max_k |u_k|:
//   y = u                   in the near region, m <= 1,
//   y = (2 - 1/m) u / m     beyond it; infinity maps to max_k |y_k| = 2,
//   unit = (y + 2) / 4.
// A bounded scene (object, room) consists of the near region only: unit = (u + 1) / 2.
// The map is continuous with a continuous first derivative along rays through the centre at m = 1.
#pragma once

#include <array>
#include <cmath>

#include "redrive/base/value_of.h"

namespace redrive {

struct Contraction {
  std::array<float, 3> center{};  ///< metres, world frame
  float half_m = 1;               ///< half the side of the near region, a cube; > 0
  bool unbounded = true;

  bool operator==(const Contraction&) const = default;
};

/// Writes the position in the unit cube and returns the cube root of the map's volume factor
/// |det d unit / d world|, in 1/m: it turns the standard deviation of a sample's volume in metres
/// into that in the unit cube. T may be a ceres::Jet; the factor is then a constant. In a bounded
/// scene points outside the near region map outside [0, 1]^3.
template <class T>
T contract(const Contraction& contraction, const T world[3], T unit[3]) {
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
  // Eigenvalues of dy/du: 1/m^2 along the radius, `shrink` across it, twice.
  double factor = 1;
  if (beyond) {
    const double along = value_of(m), across = (2 - 1 / along) / along;
    factor = std::cbrt(across * across / (along * along));
  }
  return T(0.25 / contraction.half_m * factor);
}

/// Writes d_world = (d unit / d world)^T d_unit, the vector-Jacobian product of contract's
/// position. The returned factor is taken as constant.
template <class T>
void contract_adjoint(const Contraction& contraction, const T world[3], const T d_unit[3],
                      T d_world[3]) {
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
