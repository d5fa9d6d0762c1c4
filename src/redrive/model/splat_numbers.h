// SPDX-License-Identifier: Apache-2.0
// A Gaussian in the numbers of 3D Gaussian Splatting (Kerbl et al. 2023), as file formats have it.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "redrive/field/spherical_harmonics.h"
#include "redrive/kernels/gaussian_stages.h"

namespace redrive {

struct SplatNumbers {
  std::array<double, 3> position;             ///< mean, world metres
  std::array<double, 3> dc;                   ///< (colour - 0.5) / C0 of r, g, b
  std::array<std::array<double, 3>, 3> rest;  ///< coefficients of degree 1: [channel][y, z, x]
  double opacity;                             ///< logit
  std::array<double, 3> log_scale;            ///< logarithms of the standard deviations, metres
  std::array<double, 4> quaternion;           ///< unit, w x y z
};

/// Coefficients are of the basis of field/spherical_harmonics.h, C0 its constant, over the unit
/// direction from the camera to the mean in the world.
inline SplatNumbers splat_numbers(const kernels::Gaussians& gaussians, std::size_t i) {
  // In this direction each function of degree 1 is its factor of y, z or x.
  constexpr double kAllOnes[3] = {1, 1, 1};
  constexpr int kAxis[3] = {1, 2, 0};
  double factor[kHarmonics];
  spherical_harmonics(kAllOnes, factor);
  const auto at = [&](int row) -> double { return gaussians.numbers[gaussian_slot(i, row)]; };
  SplatNumbers numbers;
  double norm2 = 0;
  for (int k = 0; k < 4; ++k) norm2 += at(kQuaternionRow + k) * at(kQuaternionRow + k);
  for (int k = 0; k < 4; ++k) numbers.quaternion[k] = at(kQuaternionRow + k) / std::sqrt(norm2);
  for (int k = 0; k < 3; ++k) {
    numbers.position[k] = at(kPositionRow + k);
    numbers.dc[k] = (at(kColourRow + k) - 0.5) / factor[0];
    numbers.log_scale[k] = at(kLogScaleRow + k);
    for (int j = 0; j < 3; ++j)
      numbers.rest[k][j] = at(kHarmonicsRow + 3 * kAxis[j] + k) / factor[1 + j];
  }
  numbers.opacity = at(kOpacityRow);
  return numbers;
}

}  // namespace redrive
