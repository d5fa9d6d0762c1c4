// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/local_level.h"

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

TEST(LocalLevel, ItsAxesLeadEastNorthAndUp) {
  constexpr double kStep = 1e-5;
  const Geodetic place{0.83, 0.33, 150};
  const Rigid3d level = ecef_from_enu(place);
  const Geodetic again =
      geodetic_from_ecef(level.translation().x(), level.translation().y(), level.translation().z());
  EXPECT_NEAR(again.latitude_rad, place.latitude_rad, 1e-9);
  EXPECT_NEAR(again.longitude_rad, place.longitude_rad, 1e-12);
  EXPECT_NEAR(again.height_m, place.height_m, 1e-4);
  const Geodetic moved[] = {{place.latitude_rad, place.longitude_rad + kStep, place.height_m},
                            {place.latitude_rad + kStep, place.longitude_rad, place.height_m},
                            {place.latitude_rad, place.longitude_rad, place.height_m + 60}};
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d step =
        level.inverse() * ecef_from_enu(moved[axis]).translation();  // about 60 m
    EXPECT_GT(step[axis], 40);
    EXPECT_LT((step - step.norm() * Eigen::Vector3d::Unit(axis)).norm(), 1e-3);
  }
}

}  // namespace
}  // namespace redrive
