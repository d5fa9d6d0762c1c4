// SPDX-License-Identifier: Apache-2.0
// Lists and counts in findings.
#pragma once

#include <algorithm>
#include <string>
#include <type_traits>
#include <vector>

namespace redrive {

/// "33643, 33644, 33645, 33646, 33647, ... (12 in all)"
template <class T>
std::string first_few(const std::vector<T>& items, std::size_t shown = 5) {
  std::string list;
  for (std::size_t i = 0; i < std::min(items.size(), shown); ++i) {
    if (i) list += ", ";
    if constexpr (std::is_arithmetic_v<T>) {
      list += std::to_string(items[i]);
    } else {
      list += items[i];
    }
  }
  return items.size() <= shown ? list
                               : list + ", ... (" + std::to_string(items.size()) + " in all)";
}

/// "1 image", "2 images"
inline std::string counted(std::size_t n, const std::string& noun) {
  return std::to_string(n) + " " + noun + (n == 1 ? "" : "s");
}

}  // namespace redrive
