// SPDX-License-Identifier: Apache-2.0
// A JSON value with its file and path, so that every error names file, field and value.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

namespace redrive {

/// A view into a parsed document (which must outlive it). Each accessor throws InputError with
/// path, field and value.
class JsonField {
 public:
  JsonField(const nlohmann::json& root, std::filesystem::path file)
      : value_(&root), file_(std::make_shared<const std::filesystem::path>(std::move(file))) {}

  bool has(std::string_view key) const;      ///< object with that key
  JsonField at(std::string_view key) const;  ///< required member
  JsonField at(std::size_t index) const;     ///< required element
  std::size_t size() const;                  ///< number of elements of an array or object
  std::vector<std::string> keys() const;  ///< keys of an object, in file order as nlohmann keeps it

  double number() const;  ///< finite; integers are accepted
  std::int64_t integer() const;
  std::string string() const;
  std::vector<double> numbers(std::size_t size) const;  ///< array of exactly `size` finite numbers
  Eigen::Matrix4d matrix4() const;                      ///< row-major 4x4, finite

  [[noreturn]] void fail(
      std::string_view rule) const;  ///< InputError about this field with its value
  const std::filesystem::path& file() const { return *file_; }
  const std::string& field() const { return field_; }
  const nlohmann::json& json() const { return *value_; }

 private:
  JsonField(const nlohmann::json* value, std::shared_ptr<const std::filesystem::path> file,
            std::string field)
      : value_(value), file_(std::move(file)), field_(std::move(field)) {}
  const nlohmann::json* value_;
  /// shared, since copying a path costs more than parsing
  std::shared_ptr<const std::filesystem::path> file_;
  std::string field_;
};

}  // namespace redrive
