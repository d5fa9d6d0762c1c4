// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/wrapped_text.h"

#include <algorithm>

namespace redrive {

std::string wrapped(const std::string& text, std::size_t begin, std::size_t indent,
                    std::size_t width) {
  std::string out;
  std::size_t column = begin;
  bool is_empty = true;  // the line
  const auto break_line = [&] {
    out += "\n" + std::string(indent, ' ');
    column = indent;
    is_empty = true;
  };
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find_first_of(" \n", at), text.size());
    if (!is_empty && column + 1 + (end - at) > width) {
      break_line();
    } else if (!is_empty) {
      out += ' ';
      ++column;
    }
    out.append(text, at, end - at);
    column += end - at;
    is_empty = false;
    if (end < text.size() && text[end] == '\n') break_line();
    at = end + 1;
  }
  return out;
}

std::string with_short_lines(std::string_view text, std::size_t width) {
  std::string out;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::string_view line = text.substr(at, end - at);
    const std::size_t indent = std::min(line.find_first_not_of(' '), line.size());
    // The bytes of a letter of UTF-8 after its first take no column.
    const auto columns = static_cast<std::size_t>(
        std::ranges::count_if(line, [](char c) { return (c & 0xc0) != 0x80; }));
    if (columns > width)
      out += std::string(indent, ' ') +
             wrapped(std::string(line.substr(indent)), indent, indent + 2, width);
    else
      out += line;
    if (end < text.size()) out += '\n';
    at = end + 1;
  }
  return out;
}

}  // namespace redrive
