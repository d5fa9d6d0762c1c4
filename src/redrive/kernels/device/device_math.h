// SPDX-License-Identifier: Apache-2.0
// GPU instructions that C++ has no expression for, with equivalents on the host.
#pragma once

#include <cstdint>

#include "redrive/base/host_device.h"

namespace redrive::kernels {

/// Returns a b + c, rounded once on a device. Other arithmetic on a device is that of the host (no
/// contraction, CMakeLists.txt).
REDRIVE_HD inline float multiply_add(float a, float b, float c) {
#ifdef __CUDA_ARCH__
  return __fmaf_rn(a, b, c);
#else
  return a * b + c;
#endif
}

/// Adds x to *to atomically. The order of concurrent additions is open, and so are the last bits of
/// a sum.
REDRIVE_HD inline void atomic_add(float* to, float x) {
#ifdef __CUDA_ARCH__
  atomicAdd(to, x);
#else
  *to += x;
#endif
}

/// Stores x at `address` atomically and returns the value before.
REDRIVE_HD inline std::uint32_t atomic_exchange(std::uint32_t* address, std::uint32_t x) {
#ifdef __CUDA_ARCH__
  return atomicExch(address, x);
#else
  const std::uint32_t before = *address;
  *address = x;
  return before;
#endif
}

/// Two consecutive numbers, the first aligned to 8 bytes: one load, one store.
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
