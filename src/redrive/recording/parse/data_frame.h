// SPDX-License-Identifier: Apache-2.0
// Tables as pandas pickles them (DataFrame.to_pickle), of old and new versions of pandas and numpy:
// blocks of columns of one type, numbers as the bytes of numpy's arrays.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace redrive {

class DataFrame {
 public:
  /// Parses a pickle, which must outlive the table: texts are views into it. InputError for other
  /// objects than tables of numbers and texts, and for ones of more values than the file has bytes.
  DataFrame(std::string_view pickle, const std::filesystem::path& file);

  std::size_t rows() const { return rows_; }
  bool has(const std::string& column) const { return columns_.contains(column); }
  /// Columns by name: floats, integers and booleans, of which doubles are exact up to 2^53, and
  /// texts, empty where there is none. InputError without such a column.
  const std::vector<double>& numbers(const std::string& column) const;
  const std::vector<std::string_view>& texts(const std::string& column) const;

 private:
  friend class DataFrameReader;
  using Column = std::variant<std::vector<double>, std::vector<std::string_view>>;

  template <class T>
  const std::vector<T>& column(const std::string& name, const char* what) const;

  std::filesystem::path file_;
  std::map<std::string, Column> columns_;
  std::size_t rows_ = 0;
};

}  // namespace redrive
