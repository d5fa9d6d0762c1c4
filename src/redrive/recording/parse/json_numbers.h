// SPDX-License-Identifier: Apache-2.0
// Numbers of a JSON document within bounds.
#pragma once

#include <array>
#include <cstddef>

#include "redrive/base/json_field.h"

namespace redrive {

/// InputError with `rule` unless the field is a number in [least, most].
inline double number_within(const JsonField& field, double least, double most, const char* rule) {
  const double value = field.number();
  if (!(value >= least && value <= most)) field.fail(rule);
  return value;
}

/// The same for an array of n numbers.
template <std::size_t n>
std::array<double, n> numbers_within(const JsonField& field, double least, double most,
                                     const char* rule) {
  if (!field.json().is_array() || field.size() != n) field.fail(rule);
  std::array<double, n> values;
  for (std::size_t k = 0; k < n; ++k) values[k] = number_within(field.at(k), least, most, rule);
  return values;
}

}  // namespace redrive
