// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>

namespace redrive {

/// x_unit = (x_world - center) * scale: from world metres to the cube [-1, 1]^3 of the NeRF field.
/// Metres end here and in Contraction (field/contraction.h) only.
struct UnitFromWorld {
  std::array<float, 3> center{};
  float scale = 1;
};

}  // namespace redrive
