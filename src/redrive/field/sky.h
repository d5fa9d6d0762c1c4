// SPDX-License-Identifier: Apache-2.0
// Sky colour as a function of the ray's direction alone: a hash grid (field/hash_grid.h) whose unit
// cube holds the unit sphere of directions. For one direction, on any scalar type, with adjoints.
#pragma once

#include <cstddef>

#include "redrive/field/activation.h"

namespace redrive {

/// Radius of the sphere of directions in the unit cube; its centre is (1/2, 1/2, 1/2).
constexpr float kSkyRadius = 0.5f;

/// Maps one coordinate of a unit direction to the unit cube.
template <class T>
T sky_coordinate(T direction) {
  return T(kSkyRadius) * (direction + T(1));
}
template <class T>
T sky_coordinate_adjoint(T d_coordinate) {
  return T(kSkyRadius) * d_coordinate;
}

/// Standard deviation of a pixel's cone on the sphere: half a pixel of side pixel_angle (rad).
inline float sky_footprint(float pixel_angle) { return 0.5f * kSkyRadius * pixel_angle; }

/// Returns one colour channel in (0, 1): the sigmoid of its feature, summed over `levels` values
/// that lie `stride` numbers apart.
template <class T>
T sky_colour(const T* feature, int levels, std::size_t stride) {
  T sum(0);
  for (int l = 0; l < levels; ++l) sum += feature[l * stride];
  return sigmoid(sum);
}
/// Returns the adjoint of the feature of each level, from the colour that sky_colour returned.
template <class T>
T sky_colour_adjoint(T colour, T d_colour) {
  return d_colour * colour * (T(1) - colour);
}

}  // namespace redrive
