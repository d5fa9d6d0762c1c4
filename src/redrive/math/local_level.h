// SPDX-License-Identifier: Apache-2.0
// The local level frame at a place on Earth: x east, y north, z up.
#pragma once

#include <cmath>

#include "redrive/math/rigid3.h"
#include "redrive/math/wgs84.h"

namespace redrive {

/// Returns its pose in ECEF, metres: the inverse of geodetic_from_ecef, with axes.
inline Rigid3d ecef_from_enu(const Geodetic& place) {
  const double latitude = place.latitude_rad, longitude = place.longitude_rad;
  const Eigen::Vector3d up(std::cos(latitude) * std::cos(longitude),
                           std::cos(latitude) * std::sin(longitude), std::sin(latitude));
  const Eigen::Vector3d east(-std::sin(longitude), std::cos(longitude), 0);
  const double normal_m =  // radius of curvature of the prime vertical
      kWgs84SemiMajor_m / std::sqrt(1 - kWgs84EccentricitySquared * up.z() * up.z());
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() << east, up.cross(east), up;
  pose.translation() = (normal_m + place.height_m) * up;
  pose.translation().z() -= kWgs84EccentricitySquared * normal_m * up.z();
  return pose;
}

}  // namespace redrive
