// SPDX-License-Identifier: Apache-2.0
// Rays in groups that a raster each can draw: seen within a quarter of a turn, from an origin that
// moves evenly with the azimuth, as their times do.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "redrive/base/parallel.h"
#include "redrive/kernels/rays.h"

namespace redrive {

/// Rays whose origin is near origin_m + by_azimuth_m azimuth, and whose times are near
/// time_at(azimuth).
struct RayGroup {
  /// Columns: x, y, z, with z to the group's middle; of a group to the sides y points down.
  Eigen::Matrix3d world_from_axes;
  Eigen::Vector3d origin_m;      ///< in the world, at azimuth 0
  Eigen::Vector3d by_azimuth_m;  ///< metres per rad
  std::int64_t first_ns = 0;     ///< time of the first ray; 0: rays have no times
  double after_ns = 0;           ///< from first_ns to the time at azimuth 0
  double by_azimuth_ns = 0;      ///< per rad
  std::vector<int> rays;         ///< indices
  /// One per ray, radians: its angles in these axes (camera/lenses/spherical.h), elevation towards
  /// y.
  std::vector<float> azimuth, elevation;

  Eigen::Vector3d origin_at(double azimuth_rad) const {
    return origin_m + azimuth_rad * by_azimuth_m;
  }
  std::int64_t time_at(double azimuth_rad) const {
    return first_ns + std::llround(after_ns + azimuth_rad * by_azimuth_ns);
  }
};

/// Farthest that the origin of a ray may be from its group's along each axis, metres.
constexpr double kOffTrack_m = 0.02;
/// Farthest that the time of a ray may be from its group's: 20 m/s are 4 cm.
constexpr double kOffTime_ns = 2e6;

/// Groups rays of unit directions. Each ray is in one group.
std::vector<RayGroup> group_rays(const kernels::Rays& rays, ThreadPool& pool);

/// Groups the rays that are at most 80 degrees to the sides of these axes' z; leaves out others.
std::vector<RayGroup> group_around(const kernels::Rays& rays,
                                   const Eigen::Matrix3d& world_from_axes);

}  // namespace redrive
