// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/did_you_mean.h"

#include <algorithm>
#include <cctype>
#include <limits>

namespace redrive {
namespace {

constexpr std::size_t kLongestWord = 200;  // longer words are not compared; names are shorter

char lower(char c) { return static_cast<char>(std::tolower(static_cast<unsigned char>(c))); }

}  // namespace

int edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::vector<int>> d(a.size() + 1, std::vector<int>(b.size() + 1));
  for (std::size_t i = 0; i <= a.size(); ++i)
    for (std::size_t j = 0; j <= b.size(); ++j) {
      if (i == 0 || j == 0) {
        d[i][j] = static_cast<int>(i + j);
        continue;
      }
      const bool same = lower(a[i - 1]) == lower(b[j - 1]);
      d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, d[i - 1][j - 1] + !same});
      if (i > 1 && j > 1 && lower(a[i - 1]) == lower(b[j - 2]) &&
          lower(a[i - 2]) == lower(b[j - 1]))
        d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
    }
  return d[a.size()][b.size()];
}

std::string did_you_mean(std::string_view word, const std::vector<std::string>& names) {
  constexpr std::size_t kLeastBeginning = 2;  // letters
  if (word.size() > kLongestWord) return "";
  const std::string* best = nullptr;
  int least = std::numeric_limits<int>::max();
  for (const std::string& name : names) {
    if (name.empty() || name.size() > kLongestWord) continue;
    const bool begins = word.size() >= kLeastBeginning && name.size() > word.size() &&
                        edit_distance(std::string_view(name).substr(0, word.size()), word) == 0;
    const int distance = begins ? 1 : edit_distance(word, name),
              most = std::max<int>(1, static_cast<int>(std::max(word.size(), name.size())) / 3);
    if (distance < least && distance <= most) {
      least = distance;
      best = &name;
    }
  }
  return best ? "; did you mean " + *best + "?" : "";
}

std::string unknown_name(std::string_view word, const std::vector<std::string>& names) {
  std::string known;
  for (const std::string& name : names)
    if (!name.empty()) known += (known.empty() ? "" : ", ") + name;
  return "unknown; known are " + known + did_you_mean(word, names);
}

}  // namespace redrive
