// SPDX-License-Identifier: Apache-2.0
// Tables in Arrow's IPC file format, which is also Feather, version 2: columns of numbers and texts
// in record batches, plain or compressed by LZ4 or Zstandard.
// https://arrow.apache.org/docs/format/Columnar.html
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace redrive {

struct ArrowLayout;

/// A column is decoded when it is asked for, so a type that is not read costs itself alone.
class ArrowTable {
 public:
  /// Reads the metadata of a file, whose bytes must outlive the table. InputError: another format,
  /// big-endian numbers, more rows than 65536 and 16 for each byte.
  ArrowTable(std::string_view bytes, const std::filesystem::path& file);
  ~ArrowTable();

  std::size_t rows() const;
  bool has(const std::string& column) const;
  /// Columns by name. InputError names the column: there is none, it has another type, or its bytes
  /// are damaged or far more than its rows need.
  /// Integers, floats of 16 to 64 bits, booleans, timestamps. Doubles are exact up to 2^53; NaN
  /// where there is no value.
  std::vector<double> numbers(const std::string& column) const;
  /// Integers, booleans and timestamps, each with a value.
  std::vector<std::int64_t> integers(const std::string& column) const;
  /// Texts, also ones by dictionary; empty where there is no value. At most 256 MB.
  std::vector<std::string> texts(const std::string& column) const;

 private:
  std::string_view bytes_;
  std::unique_ptr<const ArrowLayout> layout_;
};

/// Returns the number of rows of a file, of which little is read; 0 if it is no such file.
std::uint64_t arrow_rows(const std::filesystem::path& file);

}  // namespace redrive
