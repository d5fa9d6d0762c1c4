// SPDX-License-Identifier: Apache-2.0
// Linear triangulation: the point with the least sum of squared distances to the lines of rays.
//   A = sum (I - d d^T),  A (x - o_0) = sum (I - d d^T) (o - o_0)
// with the rays' origins o and unit directions d.
#pragma once

#include <span>

#include <Eigen/Core>

namespace redrive {

/// A ray in the world, with a unit direction.
struct WorldRay {
  Eigen::Vector3d origin, direction;
};

struct NearestToRays {
  Eigen::Vector3d from_first;  ///< from the first ray's origin; not finite for parallel rays
  /// Least eigenvalue of A, 0 for parallel rays: a point at the distance r is known to
  /// r (error of a ray, rad) / sqrt(least eigenvalue) in its least certain direction.
  double least_eigenvalue = 0;
};

/// rays: at least one.
NearestToRays nearest_to_rays(std::span<const WorldRay> rays);

}  // namespace redrive
