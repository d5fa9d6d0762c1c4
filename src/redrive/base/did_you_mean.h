// SPDX-License-Identifier: Apache-2.0
// Suggests known names for a mistyped one.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace redrive {

/// Returns the number of letters to insert, to delete, to replace or to swap with their neighbour
/// that turn one text into the other; case does not count.
int edit_distance(std::string_view a, std::string_view b);

/// Returns "; did you mean NAME?" with the name nearest to `word`: one that begins with it, or that
/// differs by at most a third of its letters. Empty where none is near.
std::string did_you_mean(std::string_view word, const std::vector<std::string>& names);

/// Returns "unknown; known are A, B; did you mean A?".
std::string unknown_name(std::string_view word, const std::vector<std::string>& names);

}  // namespace redrive
