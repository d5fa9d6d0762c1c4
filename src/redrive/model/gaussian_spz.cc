// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/gaussian_spz.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "redrive/base/error.h"
#include "redrive/base/files/gzip.h"
#include "redrive/field/splat_numbers.h"

namespace redrive {
namespace {

constexpr std::uint32_t kMagic = 0x5053474e, kVersion = 3;
constexpr std::uint8_t kAntialiased = 1;
constexpr int kMaxFractionalBits = 12;
constexpr std::int64_t kMaxPosition = (1 << 23) - 1;

/// Appends the lower bytes of a number, little-endian.
void put(std::uint32_t number, int bytes, std::string* to) {
  for (int i = 0; i < bytes; ++i) *to += static_cast<char>((number >> (8 * i)) & 255);
}

void put_byte(double number, std::string* to) {
  put(static_cast<std::uint32_t>(std::lround(std::clamp(number, 0.0, 255.0))), 1, to);
}

int fractional_bits(double largest_m) {
  int bits = kMaxFractionalBits;
  while (bits > 0 && std::ldexp(largest_m, bits) > static_cast<double>(kMaxPosition)) --bits;
  return bits;
}

/// w x y z.
std::uint32_t smallest_three(const std::array<double, 4>& q) {
  const std::array<double, 4> xyzw = {q[1], q[2], q[3], q[0]};
  const auto largest = static_cast<std::uint32_t>(
      std::ranges::max_element(xyzw, {}, [](double x) { return std::abs(x); }) - xyzw.begin());
  std::uint32_t packed = largest;
  for (std::uint32_t i = 0; i < 4; ++i) {
    if (i == largest) continue;
    const double value = xyzw[largest] < 0 ? -xyzw[i] : xyzw[i];
    const double share = std::min(1.0, std::abs(value) * std::numbers::sqrt2);
    packed = packed << 10 | (value < 0 ? 1u << 9 : 0u) |
             static_cast<std::uint32_t>(std::lround(511 * share));
  }
  return packed;
}

}  // namespace

std::string gaussian_spz(const kernels::Gaussians& gaussians, int sh_degree) {
  REDRIVE_CHECK_OP(sh_degree, >=, 0);
  REDRIVE_CHECK_OP(sh_degree, <=, 1);
  double largest_m = 0;
  for (std::size_t i = 0; i < gaussians.n; ++i)
    for (int k = 0; k < 3; ++k)
      largest_m = std::max<double>(largest_m,
                                   std::abs(gaussians.numbers[gaussian_slot(i, kPositionRow + k)]));
  const int bits = fractional_bits(largest_m);

  std::string positions, opacities, colours, scales, rotations, rest;
  for (std::size_t i = 0; i < gaussians.n; ++i) {
    const SplatNumbers numbers = splat_numbers(gaussians.numbers, i);
    for (const double x : numbers.position)
      put(static_cast<std::uint32_t>(std::clamp<std::int64_t>(std::llround(std::ldexp(x, bits)),
                                                              -kMaxPosition, kMaxPosition)),
          3, &positions);
    put_byte(255 / (1 + std::exp(-numbers.opacity)), &opacities);
    for (const double dc : numbers.dc) put_byte(255 * (0.15 * dc + 0.5), &colours);
    for (const double log_scale : numbers.log_scale) put_byte(16 * (log_scale + 10), &scales);
    put(smallest_three(numbers.quaternion), 4, &rotations);
    for (int j = 0; sh_degree > 0 && j < 3; ++j)
      for (int c = 0; c < 3; ++c) put_byte(128 * numbers.rest[c][j] + 128, &rest);
  }
  std::string bytes;
  put(kMagic, 4, &bytes);
  put(kVersion, 4, &bytes);
  put(static_cast<std::uint32_t>(gaussians.n), 4, &bytes);
  put(static_cast<std::uint32_t>(sh_degree), 1, &bytes);
  put(static_cast<std::uint32_t>(bits), 1, &bytes);
  put(kAntialiased, 1, &bytes);
  put(0, 1, &bytes);
  return gzip(bytes + positions + opacities + colours + scales + rotations + rest);
}

}  // namespace redrive
