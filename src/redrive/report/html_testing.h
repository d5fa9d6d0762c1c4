// SPDX-License-Identifier: Apache-2.0
// For tests: tables of a page.
#pragma once

#include <regex>
#include <string>

namespace redrive {

/// Returns the page without the head that each cell of a table names for narrow pages.
inline std::string without_heads(const std::string& html) {
  return std::regex_replace(html, std::regex(" data-head=\"[^\"]*\""), "");
}

}  // namespace redrive
