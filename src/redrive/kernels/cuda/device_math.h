// SPDX-License-Identifier: Apache-2.0
// What a GPU has instructions for that C++ does not say.
#pragma once

#include "redrive/base/host_device.h"

namespace redrive::kernels {

/// a b + c: rounded once on a device, whose other arithmetic is that of the host (no contraction, CMakeLists.txt).
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

}  // namespace redrive::kernels
