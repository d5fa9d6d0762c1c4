// SPDX-License-Identifier: Apache-2.0
// The ellipsoid of WGS84.
#pragma once

#include <cmath>

namespace redrive {

inline constexpr double kWgs84SemiMajor_m = 6378137.0;       // defining constant a
inline constexpr double kWgs84SemiMinor_m = 6356752.314245;  // b = a (1 - f), f = 1 / 298.257223563
inline constexpr double kWgs84EccentricitySquared = 6.69437999014e-3;  // f (2 - f)

/// Geodetic coordinates on the ellipsoid.
struct Geodetic {
  double latitude_rad = 0, longitude_rad = 0;
  double height_m = 0;  ///< above the ellipsoid
};

/// Converts from ECEF, metres. Bowring, "Transformation from spatial to geographical coordinates",
/// Survey Review 1976, one step: below 1e-9 rad for heights within 10 km. At the centre of the
/// Earth the latitude is 0 or a quarter turn.
inline Geodetic geodetic_from_ecef(double x_m, double y_m, double z_m) {
  constexpr double a = kWgs84SemiMajor_m, b = kWgs84SemiMinor_m, e2 = kWgs84EccentricitySquared;
  const double p = std::hypot(x_m, y_m);
  const double parametric = std::atan2(a * z_m, b * p);
  const double s = std::sin(parametric), c = std::cos(parametric);
  Geodetic place;
  place.longitude_rad = std::atan2(y_m, x_m);
  place.latitude_rad = std::atan2(z_m + e2 * a * a / b * s * s * s, p - e2 * a * c * c * c);
  const double sin_lat = std::sin(place.latitude_rad), cos_lat = std::cos(place.latitude_rad);
  const double normal = a / std::sqrt(1 - e2 * sin_lat * sin_lat);
  // Both forms of the height agree; each is used where its divisor is large.
  place.height_m = cos_lat > 0.7 ? p / cos_lat - normal : z_m / sin_lat - normal * (1 - e2);
  return place;
}

}  // namespace redrive
