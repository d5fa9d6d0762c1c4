// SPDX-License-Identifier: Apache-2.0
// Text files of one record per line, as words between blanks. Every error names file, line, field
// and value.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace redrive {

/// A view into a text; both it and the name of its file must outlive the view.
class TextLine {
 public:
  /// `number`: counts from 1; 0: the file is a single line, and messages leave it out.
  TextLine(std::string_view line, const std::filesystem::path& file, std::size_t number);

  std::size_t size() const { return words_.size(); }
  std::string_view word(std::size_t i) const { return words_.at(i); }
  /// Word i and everything after it, with the blanks between.
  std::string_view rest(std::size_t i) const {
    return {word(i).data(), words_.back().data() + words_.back().size()};
  }
  /// InputError unless the line has `size` words; `what` says which.
  void expect_size(std::size_t size, std::string_view what) const;

  /// Word i as a number, which may be not finite; `field` is its name.
  double any_number(std::size_t i, std::string_view field) const;
  /// Word i as a finite number from `least` to `most`; `field` is its name.
  double number(std::size_t i, std::string_view field, double least, double most) const;
  std::int64_t integer(std::size_t i, std::string_view field, std::int64_t least,
                       std::int64_t most) const;
  /// InputError about word i.
  [[noreturn]] void fail(std::size_t i, std::string_view field, std::string_view rule) const;
  std::string name() const;  ///< "line 3", or an empty text

 private:
  std::string field(std::string_view of_line) const;

  const std::filesystem::path* file_;
  std::size_t number_;
  std::vector<std::string_view> words_;
};

/// Returns the lines of a text without empty ones at its end; empty lines in between have no word.
std::vector<TextLine> text_lines(std::string_view text, const std::filesystem::path& file);

}  // namespace redrive
