// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/wgs84.h"

#include <numbers>

#include <gtest/gtest.h>

namespace redrive {
namespace {

/// The closed form: normal radius N = a / sqrt(1 - e^2 sin^2), x = (N + h) cos cos, ...
void expect_round_trip(double latitude_rad, double longitude_rad, double height_m) {
  const double s = std::sin(latitude_rad), c = std::cos(latitude_rad);
  const double normal = kWgs84SemiMajor_m / std::sqrt(1 - kWgs84EccentricitySquared * s * s);
  const Geodetic place =
      geodetic_from_ecef((normal + height_m) * c * std::cos(longitude_rad),
                         (normal + height_m) * c * std::sin(longitude_rad),
                         (normal * (1 - kWgs84EccentricitySquared) + height_m) * s);
  EXPECT_NEAR(place.latitude_rad, latitude_rad, 1e-9);
  EXPECT_NEAR(place.longitude_rad, longitude_rad, 1e-12);
  EXPECT_NEAR(place.height_m, height_m, 1e-4);
}

TEST(Wgs84, ConvertsFromEcef) {
  for (const double latitude_rad : {-1.5, -0.8, 0.0, 0.3, 0.83, 1.2, 1.57})
    for (const double longitude_rad : {-3.0, 0.0, 0.33, 2.0})
      for (const double height_m : {-100.0, 0.0, 150.0, 9000.0})
        expect_round_trip(latitude_rad, longitude_rad, height_m);
  const Geodetic pole = geodetic_from_ecef(0, 0, kWgs84SemiMinor_m + 3);
  EXPECT_NEAR(pole.latitude_rad, std::numbers::pi / 2, 1e-12);
  EXPECT_NEAR(pole.height_m, 3, 1e-4);
}

}  // namespace
}  // namespace redrive
