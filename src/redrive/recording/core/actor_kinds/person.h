// SPDX-License-Identifier: Apache-2.0
// People, also on two wheels, and animals: they articulate even when standing still.
#pragma once

#include <array>

#include "redrive/recording/core/actor_kind.h"

namespace redrive {

inline constexpr std::array<std::string_view, 13> kPersonWords = {
    "person",   "pedestrian", "human",    "cyclist", "bicyclist", "motorcyclist", "rider",
    "signaler", "wheelchair", "stroller", "animal",  "animals",   "dog"};
inline constexpr ActorKind kPerson = {
    .name = "person", .words = kPersonWords, .always_moves = true};

}  // namespace redrive
