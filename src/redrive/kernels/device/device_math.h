// SPDX-License-Identifier: Apache-2.0
// What a GPU has instructions for that C++ does not say.
#pragma once

#include <cstdint>

#include "redrive/base/host_device.h"

namespace redrive::kernels {

/// a b + c: rounded once on a device, whose other arithmetic is that of the host (no contraction,
/// CMakeLists.txt).
REDRIVE_HD inline float multiply_add(float a, float b, float c) {
#ifdef __CUDA_ARCH__
  return __fmaf_rn(a, b, c);
#else
  return a * b + c;
#endif
}

/// *to += x, whoever else adds to it. The order is open, so the last bits of a sum are.
REDRIVE_HD inline void atomic_add(float* to, float x) {
#ifdef __CUDA_ARCH__
  atomicAdd(to, x);
#else
  *to += x;
#endif
}

/// Puts x there and returns what was there, whoever else does.
REDRIVE_HD inline std::uint32_t atomic_exchange(std::uint32_t* there, std::uint32_t x) {
#ifdef __CUDA_ARCH__
  return atomicExch(there, x);
#else
  const std::uint32_t before = *there;
  *there = x;
  return before;
#endif
}

/// Two numbers that follow each other, the first at a multiple of 8 bytes: one load, one store.
struct FloatPair {
  float first, second;
};
REDRIVE_HD inline FloatPair load_pair(const float* from) {
#ifdef __CUDA_ARCH__
  const float2 both = *reinterpret_cast<const float2*>(from);
  return {both.x, both.y};
#else
  return {from[0], from[1]};
#endif
}
REDRIVE_HD inline void store_pair(float* to, float first, float second) {
#ifdef __CUDA_ARCH__
  *reinterpret_cast<float2*>(to) = make_float2(first, second);
#else
  to[0] = first;
  to[1] = second;
#endif
}

}  // namespace redrive::kernels
