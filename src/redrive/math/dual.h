// SPDX-License-Identifier: Apache-2.0
// A dual number: its value and three derivatives. Differentiates projections for the bundle
// adjustment. ceres::Jet multiplies by the reciprocal where this divides: its quotient may differ
// from the plain one in the last bit, and with it an alignment from a recorded one.
//   f(a + e) = f(a) + f'(a) e  with e^2 = 0;  chain rule per operation.
#pragma once

#include <array>
#include <cmath>

namespace redrive {

struct Dual {
  double value = 0;
  std::array<double, 3> d{};  ///< derivatives with respect to the three variables

  Dual() = default;
  explicit Dual(double constant) : value(constant) {}
  Dual(double variable, int i) : value(variable) { d[i] = 1; }  ///< the i-th variable

  /// f(x) given f and f' at x.value. A zero derivative stays zero even where the slope is infinite
  /// (sqrt at 0).
  Dual chain(double f, double slope) const {
    Dual y(f);
    for (int i = 0; i < 3; ++i) y.d[i] = d[i] == 0 ? 0 : slope * d[i];
    return y;
  }

  friend Dual operator+(Dual a, const Dual& b) {
    a.value += b.value;
    for (int i = 0; i < 3; ++i) a.d[i] += b.d[i];
    return a;
  }
  friend Dual operator-(Dual a, const Dual& b) {
    a.value -= b.value;
    for (int i = 0; i < 3; ++i) a.d[i] -= b.d[i];
    return a;
  }
  friend Dual operator*(Dual a, const Dual& b) {
    for (int i = 0; i < 3; ++i) a.d[i] = a.d[i] * b.value + a.value * b.d[i];
    a.value *= b.value;
    return a;
  }
  friend Dual operator/(Dual a, const Dual& b) {
    a.value /= b.value;
    for (int i = 0; i < 3; ++i) a.d[i] = (a.d[i] - a.value * b.d[i]) / b.value;
    return a;
  }

  // Orders by the values: branches go where the plain number would go.
  friend auto operator<=>(const Dual& a, const Dual& b) { return a.value <=> b.value; }

  friend Dual sqrt(const Dual& a) {
    const double root = std::sqrt(a.value);
    return a.chain(root, 0.5 / root);
  }
  friend Dual atan2(const Dual& y, const Dual& x) {
    const double square = x.value * x.value + y.value * y.value;
    Dual angle = y.chain(std::atan2(y.value, x.value), x.value / square);
    for (int i = 0; i < 3; ++i) angle.d[i] -= y.value / square * x.d[i];
    return angle;
  }
};

}  // namespace redrive
