// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/actor_kind.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <string>

#include "redrive/recording/core/actor_kinds/person.h"
#include "redrive/recording/core/actor_kinds/vehicle.h"

namespace redrive {
namespace {

constexpr std::array kKinds = {
    kVehicle,
    kPerson,
};

bool is_letter(unsigned char c) { return std::isalpha(c) != 0; }

}  // namespace

std::span<const ActorKind> actor_kinds() { return kKinds; }

const ActorKind& kind_of(std::string_view type) {
  for (auto at = type.begin(); at != type.end();) {
    const auto begin = std::find_if(at, type.end(), is_letter);
    const auto end = std::find_if_not(begin, type.end(), is_letter);
    std::string word(begin, end);
    std::ranges::transform(word, word.begin(), [](unsigned char c) { return std::tolower(c); });
    for (const ActorKind& kind : kKinds)
      if (std::ranges::find(kind.words, word) != kind.words.end()) return kind;
    at = end;
  }
  return kKinds.front();
}

}  // namespace redrive
