// SPDX-License-Identifier: Apache-2.0
// Ties image points to surfaces of the LiDAR. On a straight drive, a camera that is rotated about
// the driving direction sees the same motion as one that is not, but its points lie off the
// surfaces that the LiDAR measures.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "redrive/align/bundle/cost_functions.h"
#include "redrive/align/lidar/planes.h"

namespace redrive {

struct LidarTie {
  std::size_t point = 0;   ///< index of the image point
  std::int64_t t_ns = 0;   ///< time of the return nearest to the point
  SurfaceElement surface;  ///< its patch, at the point
  /// signed distance of the point from the surface under the present corrections
  double distance_m = 0;
};

/// The position of a point in the world; nothing beyond max_m from its anchor.
std::optional<Eigen::Vector3d> position_of(const InverseDepthPoint& point, double max_m);

/// Returns a tie for each of the `points` in the world with a return of a patch within 1 m and at
/// most max_distance_m from that patch's plane, in their order. Points without a position, and in
/// corners of two patches, have none.
std::vector<LidarTie> find_lidar_ties(const RigModel& model, const std::vector<LidarSample>& lidar,
                                      const std::vector<PlanarPatch>& patches,
                                      const std::vector<std::optional<Eigen::Vector3d>>& points,
                                      double max_distance_m, ThreadPool& pool);

}  // namespace redrive
