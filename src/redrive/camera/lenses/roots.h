// SPDX-License-Identifier: Apache-2.0
// Roots of lens polynomials.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

namespace redrive {

/// Returns the value of a polynomial (ascending coefficients).
double horner(std::span<const double> polynomial, double x);

/// Returns the x in (0, end), ascending, where a polynomial (ascending coefficients) changes sign.
std::vector<double> sign_changes(const std::vector<double>& polynomial, double end);

/// Returns x in [0, edge] with f(x) = target, to 1e-12 x, for an f that increases from
/// f(0) <= target, or about the edge if f stays below target. Newton's method in a bracket that
/// begins at `guess`.
template <class Function, class Slope>
double increasing_root(const Function& f, const Slope& slope, double target, double guess,
                       double edge) {
  double low = 0, high = std::min(edge, guess);
  while (high < edge && f(high) < target) high = std::min(2 * high, edge);
  double x = high;
  for (int i = 0; i < 100; ++i) {
    const double excess = f(x) - target;
    (excess > 0 ? high : low) = x;
    double next = x - excess / slope(x);
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (std::abs(next - x) <= 1e-12 * x) return next;
    x = next;
  }
  return x;
}

}  // namespace redrive
