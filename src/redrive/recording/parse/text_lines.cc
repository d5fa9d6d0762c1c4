// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/text_lines.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr std::string_view kBlanks = " \t\r";

/// The first characters of a word, which may be of any length and bytes.
std::string shown(std::string_view word) {
  constexpr std::size_t kLongest = 80;
  std::string text;
  for (const unsigned char c : word.substr(0, kLongest))
    text += c >= 0x20 && c < 0x7f ? static_cast<char>(c) : '?';
  return word.size() > kLongest ? text + "..." : text;
}

/// Whether the whole word is such a number.
template <class T>
bool parsed(std::string_view word, T* value) {
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), *value);
  return error == std::errc() && end == word.data() + word.size();
}

}  // namespace

TextLine::TextLine(std::string_view line, const std::filesystem::path& file, std::size_t number)
    : file_(&file), number_(number) {
  for (std::size_t at = 0; (at = line.find_first_not_of(kBlanks, at)) != line.npos;) {
    const std::size_t end = std::min(line.find_first_of(kBlanks, at), line.size());
    words_.push_back(line.substr(at, end - at));
    at = end;
  }
}

std::string TextLine::name() const { return number_ ? "line " + std::to_string(number_) : ""; }

std::string TextLine::field(std::string_view of_line) const {
  return (number_ ? name() + ", " : "") + std::string(of_line);
}

void TextLine::expect_size(std::size_t size, std::string_view what) const {
  if (words_.size() != size)
    throw InputError(*file_, field("number of values"), std::to_string(words_.size()),
                     "expected " + std::to_string(size) + ": " + std::string(what));
}

void TextLine::fail(std::size_t i, std::string_view of_line, std::string_view rule) const {
  throw InputError(*file_, field(of_line), shown(word(i)), rule);
}

double TextLine::any_number(std::size_t i, std::string_view field) const {
  double value = 0;
  if (!parsed(word(i), &value)) fail(i, field, "a number was expected");
  return value;
}

double TextLine::number(std::size_t i, std::string_view field, double least, double most) const {
  double value = 0;
  if (!parsed(word(i), &value) || !std::isfinite(value))
    fail(i, field, "a finite number was expected");
  if (!(value >= least && value <= most)) {
    char rule[80];
    std::snprintf(rule, sizeof rule, "must be between %g and %g", least, most);
    fail(i, field, rule);
  }
  return value;
}

std::int64_t TextLine::integer(std::size_t i, std::string_view field, std::int64_t least,
                               std::int64_t most) const {
  std::int64_t value = 0;
  if (!parsed(word(i), &value)) fail(i, field, "a whole number was expected");
  if (value < least || value > most)
    fail(i, field, "must be between " + std::to_string(least) + " and " + std::to_string(most));
  return value;
}

std::vector<TextLine> text_lines(std::string_view text, const std::filesystem::path& file) {
  std::vector<TextLine> lines;
  std::size_t last = 0;  // number of lines up to the last with a word
  for (std::size_t begin = 0; begin < text.size();) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    lines.emplace_back(text.substr(begin, end - begin), file, lines.size() + 1);
    if (lines.back().size() > 0) last = lines.size();
    begin = end + 1;
  }
  lines.erase(lines.begin() + static_cast<std::ptrdiff_t>(last), lines.end());
  return lines;
}

}  // namespace redrive
