// SPDX-License-Identifier: Apache-2.0
// Activation functions of NeRF, on any scalar type.
#pragma once

#include <cmath>

namespace redrive {

/// max(0, x); the derivative at 0 is 0. NaN stays NaN, so that a diverged network does not look
/// like an empty scene.
template <class T>
T relu(T x) {
  return x <= T(0) ? T(0) : x;
}

/// 1 / (1 + e^-x): 0 at -infinity, 1 at +infinity.
template <class T>
T sigmoid(T x) {
  using std::exp;
  return T(1) / (T(1) + exp(-x));
}

}  // namespace redrive
