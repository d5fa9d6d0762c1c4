// SPDX-License-Identifier: Apache-2.0
// The arithmetic that formulas are templated on where one body serves numbers and SIMD vectors:
// double and ceres::Jet in references and tests (NumberMath), vectors of floats in kernels/cpu.
// There a vector type of its own keeps each instruction set's instances apart, so that the linker
// never merges them.
//
// An arithmetic M has the types Real and Mask (the result of comparing Reals), kLanes, and the
// functions of NumberMath.
#pragma once

#include <cmath>

#include "redrive/base/value_of.h"

#define REDRIVE_LANES inline __attribute__((always_inline))

namespace redrive {

template <class T>
struct NumberMath {
  using Real = T;
  using Mask = bool;
  static constexpr int kLanes = 1;

  static Real constant(double x) { return Real(x); }
  static Real sqrt(const Real& x) {
    using std::sqrt;
    return sqrt(x);
  }
  static Real atan2(const Real& y, const Real& x) {
    using std::atan2;
    return atan2(y, x);
  }
  static Real exp(const Real& x) {
    using std::exp;
    return exp(x);
  }
  static Real log(const Real& x) {
    using std::log;
    return log(x);
  }
  static Real min(const Real& a, const Real& b) { return a < b ? a : b; }
  static Real max(const Real& a, const Real& b) { return a > b ? a : b; }
  static Real select(Mask holds, const Real& a, const Real& b) { return holds ? a : b; }
  static Mask both(Mask a, Mask b) { return a && b; }
  static Mask either(Mask a, Mask b) { return a || b; }
  static bool any(Mask mask) { return mask; }
  /// Returns x without its derivatives.
  static Real stopped(const Real& x) { return Real(value_of(x)); }
};

}  // namespace redrive
