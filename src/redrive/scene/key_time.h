// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace redrive {

/// A time among the keys of a track: the keys that bracket it.
struct KeyTime {
  std::size_t before = 0, after = 0;  ///< indices of keys, equal where the pose is extrapolated
  double part = 0;                    ///< part of the way from one to the other, 0..1
};

}  // namespace redrive
