// SPDX-License-Identifier: Apache-2.0
// Cars, trucks and all else that is rigid.
#pragma once

#include "redrive/recording/core/actor_kind.h"

namespace redrive {

inline constexpr ActorKind kVehicle = {.name = "vehicle", .core = 0.7, .headlights = true};

}  // namespace redrive
