// SPDX-License-Identifier: Apache-2.0
// What stands behind everything, by direction alone: a hash grid (hash_grid.h) in whose cube the
// unit sphere lies. Scalar, one direction, on any scalar type, and the adjoint.
#pragma once

#include <cstddef>

#include "redrive/base/host_device.h"
#include "redrive/field/activation.h"

namespace redrive {

/// Of a direction's sphere in the unit cube, whose middle is 1/2.
constexpr float kSkyRadius = 0.5f;

/// Where a unit direction lies in the cube, coordinate by coordinate.
template <class T>
REDRIVE_HD T sky_coordinate(T direction) {
  return T(kSkyRadius) * (direction + T(1));
}
template <class T>
REDRIVE_HD T sky_coordinate_adjoint(T d_coordinate) {
  return T(kSkyRadius) * d_coordinate;
}

/// Of a sample there: half a pixel, whose side is pixel_angle (rad).
REDRIVE_HD inline float sky_footprint(float pixel_angle) { return 0.5f * kSkyRadius * pixel_angle; }

/// A colour's share in [0, 1]: its feature, summed over `levels` that lie `stride` numbers apart,
/// through a sigmoid.
template <class T>
REDRIVE_HD T sky_colour(const T* feature, int levels, std::size_t stride) {
  T sum(0);
  for (int l = 0; l < levels; ++l) sum += feature[l * stride];
  return sigmoid(sum);
}
/// The derivative of the feature in each of the levels, from the colour as sky_colour gave it.
template <class T>
REDRIVE_HD T sky_colour_adjoint(T colour, T d_colour) {
  return d_colour * colour * (T(1) - colour);
}

}  // namespace redrive
