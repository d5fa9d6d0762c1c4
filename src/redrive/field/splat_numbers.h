// SPDX-License-Identifier: Apache-2.0
// A Gaussian in the numbers of 3D Gaussian Splatting (Kerbl et al. 2023), as file formats have it.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <span>

#include "redrive/field/gaussian.h"
#include "redrive/field/spherical_harmonics.h"

namespace redrive {

struct SplatNumbers {
  std::array<double, 3> position;             ///< mean, world metres
  std::array<double, 3> dc;                   ///< (colour - 0.5) / C0 of r, g, b
  std::array<std::array<double, 3>, 3> rest;  ///< coefficients of degree 1: [channel][y, z, x]
  double opacity;                             ///< logit
  std::array<double, 3> log_scale;            ///< logarithms of the standard deviations, metres
  std::array<double, 4> quaternion;           ///< unit, w x y z
};

namespace splat_numbers_detail {

/// Rows of the harmonics in the order of SplatNumbers::rest: by y, z, x.
constexpr int kAxis[3] = {1, 2, 0};

/// Constants of the functions of degree 0 and 1: in this direction each of degree 1 is its factor
/// of y, z or x.
struct HarmonicFactors {
  double of[kHarmonics];
  HarmonicFactors() {
    constexpr double kAllOnes[3] = {1, 1, 1};
    spherical_harmonics(kAllOnes, of);
  }
};

}  // namespace splat_numbers_detail

/// Returns Gaussian i of `blocks`. Coefficients are of the basis of field/spherical_harmonics.h, C0
/// its constant, over the unit direction from the camera to the mean in the world.
inline SplatNumbers splat_numbers(std::span<const float> blocks, std::size_t i) {
  using namespace splat_numbers_detail;
  const HarmonicFactors factor;
  const auto at = [&](int row) -> double { return blocks[gaussian_slot(i, row)]; };
  SplatNumbers numbers;
  double norm2 = 0;
  for (int k = 0; k < 4; ++k) norm2 += at(kQuaternionRow + k) * at(kQuaternionRow + k);
  for (int k = 0; k < 4; ++k) numbers.quaternion[k] = at(kQuaternionRow + k) / std::sqrt(norm2);
  for (int k = 0; k < 3; ++k) {
    numbers.position[k] = at(kPositionRow + k);
    numbers.dc[k] = (at(kColourRow + k) - 0.5) / factor.of[0];
    numbers.log_scale[k] = at(kLogScaleRow + k);
    for (int j = 0; j < 3; ++j)
      numbers.rest[k][j] = at(kHarmonicsRow + 3 * kAxis[j] + k) / factor.of[1 + j];
  }
  numbers.opacity = at(kOpacityRow);
  return numbers;
}

/// Writes Gaussian i of `blocks`: the inverse of splat_numbers. distance_m: value of kDistanceRow.
inline void set_splat_numbers(const SplatNumbers& numbers, double distance_m, std::size_t i,
                              std::span<float> blocks) {
  using namespace splat_numbers_detail;
  const HarmonicFactors factor;
  const auto set = [&](int row, double value) {
    blocks[gaussian_slot(i, row)] = static_cast<float>(value);
  };
  for (int k = 0; k < 3; ++k) {
    set(kPositionRow + k, numbers.position[k]);
    set(kColourRow + k, 0.5 + factor.of[0] * numbers.dc[k]);
    set(kLogScaleRow + k, numbers.log_scale[k]);
    for (int j = 0; j < 3; ++j)
      set(kHarmonicsRow + 3 * kAxis[j] + k, factor.of[1 + j] * numbers.rest[k][j]);
  }
  for (int k = 0; k < 4; ++k) set(kQuaternionRow + k, numbers.quaternion[k]);
  set(kOpacityRow, numbers.opacity);
  for (int row = kLidarRow; row < kDistanceRow; ++row) set(row, row == kReturnRow);
  set(kDistanceRow, distance_m);
}

}  // namespace redrive
