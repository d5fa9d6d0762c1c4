// SPDX-License-Identifier: Apache-2.0
// Tables in JSON of any size: an array of objects, cut into its records while its bytes arrive.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>

namespace redrive {

/// Calls `use` with the text and the index of each record, which is not parsed: most records of a
/// table are of no interest, and a table may be larger than memory. The text is valid during the
/// call.
class RecordScanner {
 public:
  using Use = std::function<void(std::string_view record, std::size_t index)>;
  /// `file` is for messages.
  RecordScanner(std::filesystem::path file, Use use)
      : file_(std::move(file)), use_(std::move(use)) {}

  /// Takes the next bytes. InputError: no array of objects, a record of more than 1 MB or 64
  /// levels.
  void add(std::string_view bytes);
  /// InputError unless the array has ended.
  void finish() const;

  const std::filesystem::path& file() const { return file_; }

 private:
  enum class At { kBegin, kFirst, kRecord, kAfterRecord, kAfterComma, kEnd };
  /// Returns the position after the record that goes on at bytes[i], or the end of the bytes.
  std::size_t skip_record(std::string_view bytes, std::size_t i);
  [[noreturn]] void fail(const std::string& rule) const;

  std::filesystem::path file_;
  Use use_;
  At at_ = At::kBegin;
  bool in_string_ = false, escaped_ = false;
  int depth_ = 0;
  std::size_t records_ = 0;
  std::string begun_;  ///< beginning of a record from earlier bytes
};

/// Reads a file into the scanner. InputError as RecordScanner, and if it is missing or unreadable.
void scan_file(RecordScanner* scanner);

}  // namespace redrive
