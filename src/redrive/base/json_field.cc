// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/json_field.h"

#include <cmath>

#include "redrive/base/error.h"

namespace redrive {

bool JsonField::has(std::string_view key) const {
  return value_->is_object() && value_->contains(key);
}

JsonField JsonField::at(std::string_view key) const {
  if (!value_->is_object()) fail("an object was expected");
  std::string field;
  field.reserve(field_.size() + 1 + key.size());
  field += field_;
  if (!field_.empty()) field += '.';
  field += key;
  const auto it = value_->find(key);
  if (it == value_->end()) throw InputError(*file_, field, "", "missing");
  return {&*it, file_, std::move(field)};
}

JsonField JsonField::at(std::size_t index) const {
  if (!value_->is_array()) fail("an array was expected");
  if (index >= value_->size())
    fail("has " + std::to_string(value_->size()) + " elements, more were expected");
  return {&(*value_)[index], file_, field_ + "[" + std::to_string(index) + "]"};
}

std::size_t JsonField::size() const {
  if (!value_->is_structured()) fail("an array or object was expected");
  return value_->size();
}

std::vector<std::string> JsonField::keys() const {
  if (!value_->is_object()) fail("an object was expected");
  std::vector<std::string> keys;
  for (const auto& item : value_->items()) keys.push_back(item.key());
  return keys;
}

double JsonField::number() const {
  if (!value_->is_number()) fail("a number was expected");
  const double number = value_->get<double>();
  if (!std::isfinite(number)) fail("a finite number was expected");
  return number;
}

std::int64_t JsonField::integer() const {
  if (value_->is_number_unsigned() && value_->get<std::uint64_t>() > std::uint64_t{INT64_MAX})
    fail("too large");
  if (value_->is_number_integer()) return value_->get<std::int64_t>();
  constexpr double kExact = 0x1p53;  // integers up to here are exact in a double
  if (value_->is_number_float()) {
    const double number = value_->get<double>();
    if (std::abs(number) <= kExact && number == std::floor(number))
      return static_cast<std::int64_t>(number);
  }
  fail("an integer was expected");
}

std::string JsonField::string() const {
  if (!value_->is_string()) fail("a string was expected");
  return value_->get<std::string>();
}

std::vector<double> JsonField::numbers(std::size_t size) const {
  if (!value_->is_array() || value_->size() != size)
    fail("an array of " + std::to_string(size) + " numbers was expected");
  std::vector<double> numbers(size);
  for (std::size_t i = 0; i < size; ++i) {
    const nlohmann::json& value = (*value_)[i];
    if (value.is_number()) numbers[i] = value.get<double>();
    if (!value.is_number() || !std::isfinite(numbers[i])) at(i).number();  // throws
  }
  return numbers;
}

Eigen::Matrix4d JsonField::matrix4() const {
  if (!value_->is_array() || value_->size() != 4) fail("a 4x4 matrix (four rows) was expected");
  Eigen::Matrix4d matrix;
  for (int row = 0; row < 4; ++row) {
    const std::vector<double> values = at(row).numbers(4);
    for (int column = 0; column < 4; ++column) matrix(row, column) = values[column];
  }
  return matrix;
}

void JsonField::fail(std::string_view rule) const {
  constexpr std::size_t kLongest = 80;
  std::string value = value_->dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  if (value.size() > kLongest) value = value.substr(0, kLongest) + "...";
  throw InputError(*file_, field_, value, rule);
}

}  // namespace redrive
