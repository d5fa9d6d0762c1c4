// SPDX-License-Identifier: Apache-2.0
// Rays from points and directions, packed as the kernels take them.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "redrive/kernels/rays.h"

namespace redrive {

struct OwnRays {
  std::vector<Eigen::Vector3d> origins, directions;
  std::vector<float> origin, direction;  ///< as view() packs them

  kernels::Rays view() {
    const std::size_t n = origins.size();
    origin.resize(3 * n);
    direction.resize(3 * n);
    for (std::size_t i = 0; i < n; ++i)
      for (int k = 0; k < 3; ++k) {
        origin[k * n + i] = static_cast<float>(origins[i][k]);
        direction[k * n + i] = static_cast<float>(directions[i][k]);
      }
    return {static_cast<int>(n), origin, direction};
  }
};

}  // namespace redrive
