// SPDX-License-Identifier: Apache-2.0
// Rays in groups that a raster each can draw: seen within a quarter of a turn, from an origin that
// moves evenly with the azimuth.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "redrive/base/parallel.h"
#include "redrive/kernels/rays.h"

namespace redrive {

/// Rays whose origin is near origin_m + by_azimuth_m azimuth.
struct RayGroup {
  Eigen::Matrix3d world_from_axes;  ///< columns: x right, y down, z to the group's middle
  Eigen::Vector3d origin_m, by_azimuth_m;
  std::vector<int> rays;  ///< indices
  /// One per ray, radians: its angles in these axes (camera/spherical.h). At most 45 degrees to the
  /// sides, 56 degrees up and down.
  std::vector<float> azimuth, elevation;

  Eigen::Vector3d origin_at(double azimuth_rad) const {
    return origin_m + azimuth_rad * by_azimuth_m;
  }
};

/// Farthest that the origin of a ray may be from its group's, metres.
constexpr double kOffTrack_m = 0.02;

/// Groups rays of unit directions. Each ray is in one group.
std::vector<RayGroup> group_rays(const kernels::Rays& rays, ThreadPool& pool);

}  // namespace redrive
