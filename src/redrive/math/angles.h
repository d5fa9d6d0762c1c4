// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <numbers>

namespace redrive {

inline constexpr double kDegreesPerRadian = 180 / std::numbers::pi;
inline constexpr double kRadiansPerDegree = std::numbers::pi / 180;

}  // namespace redrive
