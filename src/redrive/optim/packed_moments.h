// SPDX-License-Identifier: Apache-2.0
// Adam's two moments of a parameter in a word of 32 bits: the first one's upper 16 bits, as bf16
// has them, then the second one's without its sign, which is never negative: 8 bits of exponent
// and 8 of mantissa. Both are rounded to nearest: to 2^-8 of the first moment and 2^-9 of the
// second one at worst.
#pragma once

#include <bit>
#include <cstdint>

namespace redrive {

constexpr std::uint32_t pack_moments(float first, float second) {
  return ((std::bit_cast<std::uint32_t>(first) + 0x8000u) & 0xffff0000u) |
         ((std::bit_cast<std::uint32_t>(second) + 0x4000u) >> 15);
}
constexpr float unpacked_first(std::uint32_t packed) {
  return std::bit_cast<float>(packed & 0xffff0000u);
}
constexpr float unpacked_second(std::uint32_t packed) {
  return std::bit_cast<float>((packed & 0xffffu) << 15);
}

}  // namespace redrive
