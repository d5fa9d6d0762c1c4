// SPDX-License-Identifier: Apache-2.0
// Band-limited patterns: detail finer than a footprint averages out instead of flickering.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace redrive::drive {

/// Uniform in [0, 1) for a cell of the plane. Mixer: "lowbias32" by C. Wellons.
inline float cell_value(std::int64_t x, std::int64_t y, std::uint32_t seed) {
  std::uint32_t h = static_cast<std::uint32_t>(x) * 0x9E3779B1u ^
                    static_cast<std::uint32_t>(y) * 0x85EBCA77u ^ seed * 0xC2B2AE3Du;
  h = (h ^ (h >> 16)) * 0x21F0AAADu;
  h = (h ^ (h >> 15)) * 0x735A2D97u;
  return static_cast<float>((h ^ (h >> 15)) >> 8) * 0x1p-24f;
}

inline std::int64_t cell_of(double x) { return static_cast<std::int64_t>(std::floor(x)); }
inline double part_of_cell(double x) { return x - std::floor(x); }

/// Value noise, -1..1: random values at the lattice of whole numbers, smoothly interpolated.
inline float value_noise(double x, double y, std::uint32_t seed) {
  const double fx = std::floor(x), fy = std::floor(y);
  const auto ix = static_cast<std::int64_t>(fx), iy = static_cast<std::int64_t>(fy);
  const auto smooth = [](float f) { return f * f * (3 - 2 * f); };
  const float u = smooth(static_cast<float>(x - fx)), v = smooth(static_cast<float>(y - fy));
  const float low = cell_value(ix, iy, seed) * (1 - u) + cell_value(ix + 1, iy, seed) * u,
              high = cell_value(ix, iy + 1, seed) * (1 - u) + cell_value(ix + 1, iy + 1, seed) * u;
  return 2 * (low + v * (high - low)) - 1;
}

/// Octaves of value noise from cells of cell_m on, each half as large as the one before; those
/// finer than the footprint are left out gradually. `gain`: amplitude of an octave by that before.
inline float octaves(double x_m, double y_m, double cell_m, int n, float gain, double footprint_m,
                     std::uint32_t seed) {
  float sum = 0, amplitude = 1;
  for (int i = 0; i < n; ++i) {
    const float visible =
        std::clamp(static_cast<float>(cell_m / footprint_m) - 1, 0.0f, 1.0f) * amplitude;
    if (visible <= 0) break;
    sum += visible * value_noise(x_m / cell_m, y_m / cell_m, seed + static_cast<std::uint32_t>(i));
    amplitude *= gain;
    cell_m /= 2;
  }
  return sum;
}

/// Coverage, 0..1, of a footprint around x by lines of width_m whose centres are period_m apart.
inline float lines(double x_m, double period_m, double width_m, double footprint_m) {
  const double footprint = std::clamp(footprint_m, 1e-4, period_m / 2),
               distance = period_m * std::abs(part_of_cell(x_m / period_m + 0.5) - 0.5);
  return static_cast<float>(std::max(0.0, std::min(distance + footprint / 2, width_m / 2) -
                                              std::max(distance - footprint / 2, -width_m / 2)) /
                            footprint);
}

/// Coverage, 0..1, of a footprint around x by the interval low..high.
inline float inside(double x_m, double low_m, double high_m, double footprint_m) {
  const double footprint = std::max(footprint_m, 1e-4);
  return static_cast<float>(
      std::max(0.0, std::min(x_m + footprint / 2, high_m) - std::max(x_m - footprint / 2, low_m)) /
      footprint);
}

}  // namespace redrive::drive
