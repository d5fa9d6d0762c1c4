// SPDX-License-Identifier: Apache-2.0
// People, also on two wheels, and animals: they articulate even when standing still.
#pragma once

#include <array>

#include "redrive/recording/core/actor_kind.h"

namespace redrive {

inline constexpr std::array<std::string_view, 7> kPersonWords = {
    "person", "pedestrian", "human", "cyclist", "rider", "animal", "animals"};
inline constexpr ActorKind kPerson = {
    .name = "person", .words = kPersonWords, .always_moves = true};

}  // namespace redrive
