// SPDX-License-Identifier: Apache-2.0
// Planes of the surfaces that LiDAR returns lie on, and Gaussians that are flattened onto them.
//
// Images alone leave the shape of a Gaussian along their rays open: it may stick out of the road as
// long as it covers the right pixels of the training images. From aside it is then a spike.
#pragma once

#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/model/gaussian_points.h"
#include "redrive/scene/lidar_returns.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// The plane through the neighbourhood of a return.
struct SurfacePlane {
  Eigen::Vector3f mean = Eigen::Vector3f::Zero(), normal = Eigen::Vector3f::Zero();  ///< unit
  float radius_m = 0;  ///< of the neighbourhood; 0: it lies in no plane
};

/// Planes of a scene in metres.
class SurfacePlanes {
 public:
  /// Thins the returns, a million at most, and fits a plane to each one's neighbours. The
  /// neighbours lie in a plane if they are up to 3 cm and 0.2 % of the distance from it, RMS, which
  /// allows for errors of ranges and poses. The number of threads changes nothing.
  SurfacePlanes(const Scene& scene, const LidarReturns& lidar, ThreadPool& pool);

  SurfacePlanes(const SurfacePlanes&) = delete;
  SurfacePlanes& operator=(const SurfacePlanes&) = delete;

  /// Returns the plane of the return nearest to `position`, if that is within 10 cm and 1 % of
  /// `distance` from the plane and inside its radius. Null: none. distance: to the nearest training
  /// camera, metres.
  const SurfacePlane* at(const Eigen::Vector3f& position, float distance) const;

 private:
  Points points_;
  std::vector<SurfacePlane> planes_;  ///< by point
  PointSet set_{points_};
  PointTree tree_;
};

/// Moves the first n Gaussians of blocks `numbers` towards the planes that they lie in: `rate` of
/// the way in one call, in (0, 1]. The covariance becomes M C M with M = I - r n n^T, where r is
/// `rate`, or less where it would become thinner than 1e-4 of the distance to the cameras. Axes
/// keep their order, so that Adam's moments stay with them. The number of threads changes nothing.
void flatten_gaussians(const SurfacePlanes& planes, float rate, std::size_t n, float* numbers,
                       ThreadPool& pool);

}  // namespace redrive
