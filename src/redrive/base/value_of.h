// SPDX-License-Identifier: Apache-2.0
// The plain number behind a scalar, for code that also runs on numbers with derivatives.
#pragma once

#include <type_traits>

namespace redrive {

/// Returns x without its derivatives: x itself, or the scalar part `a` of a ceres::Jet, with which
/// tests differentiate. Takes any type with such a member, so that Ceres need not be included.
template <class T>
constexpr auto value_of(const T& x) {
  if constexpr (std::is_arithmetic_v<T>)
    return x;
  else
    return x.a;
}

}  // namespace redrive
