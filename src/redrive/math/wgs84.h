// SPDX-License-Identifier: Apache-2.0
// The ellipsoid of WGS84.
#pragma once

namespace redrive {

inline constexpr double kWgs84SemiMajor_m = 6378137.0;       // defining constant a
inline constexpr double kWgs84SemiMinor_m = 6356752.314245;  // b = a (1 - f), f = 1 / 298.257223563
inline constexpr double kWgs84EccentricitySquared = 6.69437999014e-3;  // f (2 - f)

}  // namespace redrive
