// SPDX-License-Identifier: Apache-2.0
// Forward-mode automatic differentiation: a number that carries its value and N derivatives. Every
// scalar function of redrive is templated, so Dual<double, N> gives its exact derivative: the
// oracle that adjoints are tested against.
//   f(a + e) = f(a) + f'(a) e  with e^2 = 0;  chain rule per operation.
#pragma once

#include <array>
#include <cmath>
#include <concepts>
#include <cstddef>

namespace redrive {

template <class T, std::size_t N>
struct Dual {
  T value{};
  std::array<T, N> d{};  ///< derivatives with respect to the N variables

  constexpr Dual() = default;
  template <class U>
  requires std::convertible_to<U, T>
  constexpr Dual(U constant)
      : value(static_cast<T>(constant)) {}  // NOLINT: a constant is a Dual without derivatives

  /// The i-th independent variable at `value`.
  static constexpr Dual variable(T value, std::size_t i) {
    Dual x(value);
    x.d[i] = T(1);
    return x;
  }

  /// f(x) given f and f' at x.value. A zero derivative stays zero even where the slope is infinite
  /// (sqrt at 0).
  constexpr Dual chain(T f, T slope) const {
    Dual y(f);
    for (std::size_t i = 0; i < N; ++i) y.d[i] = d[i] == T(0) ? T(0) : slope * d[i];
    return y;
  }

  constexpr Dual& operator+=(const Dual& b) {
    value += b.value;
    for (std::size_t i = 0; i < N; ++i) d[i] += b.d[i];
    return *this;
  }
  constexpr Dual& operator-=(const Dual& b) {
    value -= b.value;
    for (std::size_t i = 0; i < N; ++i) d[i] -= b.d[i];
    return *this;
  }
  constexpr Dual& operator*=(const Dual& b) {
    for (std::size_t i = 0; i < N; ++i) d[i] = d[i] * b.value + value * b.d[i];
    value *= b.value;
    return *this;
  }
  constexpr Dual& operator/=(const Dual& b) {
    value /= b.value;
    for (std::size_t i = 0; i < N; ++i) d[i] = (d[i] - value * b.d[i]) / b.value;
    return *this;
  }

  friend constexpr Dual operator+(Dual a, const Dual& b) { return a += b; }
  friend constexpr Dual operator-(Dual a, const Dual& b) { return a -= b; }
  friend constexpr Dual operator*(Dual a, const Dual& b) { return a *= b; }
  friend constexpr Dual operator/(Dual a, const Dual& b) { return a /= b; }
  friend constexpr Dual operator+(const Dual& a) { return a; }
  friend constexpr Dual operator-(const Dual& a) { return a.chain(-a.value, T(-1)); }

  // Order and equality are those of the values: branches go where the plain number would go.
  friend constexpr bool operator==(const Dual& a, const Dual& b) { return a.value == b.value; }
  friend constexpr auto operator<=>(const Dual& a, const Dual& b) { return a.value <=> b.value; }

  friend Dual sqrt(const Dual& a) {
    const T root = std::sqrt(a.value);
    return a.chain(root, T(0.5) / root);
  }
  friend Dual exp(const Dual& a) {
    const T e = std::exp(a.value);
    return a.chain(e, e);
  }
  friend Dual expm1(const Dual& a) { return a.chain(std::expm1(a.value), std::exp(a.value)); }
  friend Dual log(const Dual& a) { return a.chain(std::log(a.value), T(1) / a.value); }
  friend Dual sin(const Dual& a) { return a.chain(std::sin(a.value), std::cos(a.value)); }
  friend Dual cos(const Dual& a) { return a.chain(std::cos(a.value), -std::sin(a.value)); }
  friend Dual tan(const Dual& a) {
    const T t = std::tan(a.value);
    return a.chain(t, T(1) + t * t);
  }
  friend Dual atan(const Dual& a) {
    return a.chain(std::atan(a.value), T(1) / (T(1) + a.value * a.value));
  }
  friend Dual atan2(const Dual& y, const Dual& x) {
    const T square = x.value * x.value + y.value * y.value;
    Dual angle = y.chain(std::atan2(y.value, x.value), x.value / square);
    for (std::size_t i = 0; i < N; ++i) angle.d[i] -= y.value / square * x.d[i];
    return angle;
  }
  friend Dual pow(const Dual& a, const Dual& b) {
    const T p = std::pow(a.value, b.value);
    Dual y = a.chain(p, b.value * std::pow(a.value, b.value - T(1)));
    for (std::size_t i = 0; i < N; ++i)
      if (b.d[i] != T(0))
        y.d[i] += p * std::log(a.value) * b.d[i];  // log(a) may be NaN where b is a constant
    return y;
  }
  friend constexpr Dual abs(const Dual& a) { return a.value < T(0) ? -a : a; }
  friend bool isfinite(const Dual& a) { return std::isfinite(a.value); }
};

}  // namespace redrive
