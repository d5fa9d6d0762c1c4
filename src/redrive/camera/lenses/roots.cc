// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/roots.h"

namespace redrive {

double horner(std::span<const double> polynomial, double x) {
  double sum = 0;
  for (std::size_t i = polynomial.size(); i-- > 0;) sum = sum * x + polynomial[i];
  return sum;
}

// The polynomial is monotone between neighbouring extrema, the sign changes of its derivative, so
// bisection finds every root.
std::vector<double> sign_changes(const std::vector<double>& polynomial, double end) {
  if (polynomial.size() < 2) return {};
  std::vector<double> derivative(polynomial.size() - 1);
  for (std::size_t i = 0; i < derivative.size(); ++i)
    derivative[i] = polynomial[i + 1] * static_cast<double>(i + 1);
  std::vector<double> ends = sign_changes(derivative, end);
  ends.push_back(end);

  std::vector<double> roots;
  double begin = 0;
  for (const double stop : ends) {
    const bool positive = horner(polynomial, begin) > 0;
    if (positive != (horner(polynomial, stop) > 0)) {
      double low = begin, high = stop;
      for (int i = 0; i < 200 && low < high; ++i) {
        const double middle = 0.5 * (low + high);
        if (middle == low || middle == high) break;
        ((horner(polynomial, middle) > 0) == positive ? low : high) = middle;
      }
      roots.push_back(low);
    }
    begin = stop;
  }
  return roots;
}

}  // namespace redrive
