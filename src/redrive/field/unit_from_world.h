// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>

namespace redrive {

/// World (metres) to unit cube: x_unit = (x_world - center) * scale. The only place where metres
/// end.
struct UnitFromWorld {
  std::array<float, 3> center{};
  float scale = 1;
};

}  // namespace redrive
