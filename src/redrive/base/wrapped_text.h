// SPDX-License-Identifier: Apache-2.0
// Breaks text between words into lines of a terminal.
#pragma once

#include <string>
#include <string_view>

namespace redrive {

/// Returns text in lines of at most `width` columns, all but the first indented by `indent`; the
/// first begins at column `begin`.
std::string wrapped(const std::string& text, std::size_t begin, std::size_t indent,
                    std::size_t width = 80);

/// Returns text whose lines of more than `width` columns are broken; further lines begin two
/// columns to the right of the first. A longer word stays whole.
std::string with_short_lines(std::string_view text, std::size_t width);

}  // namespace redrive
