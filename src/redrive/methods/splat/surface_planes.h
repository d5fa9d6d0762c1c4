// SPDX-License-Identifier: Apache-2.0
// Planes fitted to LiDAR returns, and Gaussians that are flattened onto them.
//
// Images constrain the extent of a Gaussian along their rays weakly. On a road that all cameras see
// at a grazing angle, Gaussians stick out of the surface, and views from aside show spikes.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/methods/splat/gaussian_points.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// The plane through the neighbourhood of a return.
struct SurfacePlane {
  Eigen::Vector3f mean = Eigen::Vector3f::Zero();    ///< mean of the neighbours, world metres
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();  ///< unit, of either sign
  float radius_m = 0;                                ///< radius of the neighbourhood; 0: not planar
};

/// Planes of a scene in metres.
class SurfacePlanes {
 public:
  /// Thins the returns, a million at most, and fits a plane to the 16 nearest neighbours of each by
  /// principal component analysis. Neighbours are planar if their RMS residual is at most 3 cm +
  /// 0.2 % of the distance to the nearest camera, which allows for errors of ranges and poses, and
  /// at most 0.15 of their smaller RMS extent in the plane. Poses are as recorded, so that a
  /// resumed run has the same planes. The number of threads changes no bit.
  SurfacePlanes(const Scene& scene, const LidarReturns& lidar, ThreadPool& pool);

  SurfacePlanes(const SurfacePlanes&) = delete;
  SurfacePlanes& operator=(const SurfacePlanes&) = delete;

  /// Returns the plane of the return nearest to `position`, if `position` is within its radius and
  /// within max(10 cm, 1 % of `distance`) of the plane; else null. distance: from `position` to the
  /// nearest training camera, metres.
  const SurfacePlane* at(const Eigen::Vector3f& position, float distance) const;

 private:
  Points points_;
  std::vector<SurfacePlane> planes_;  ///< one per point
  PointSet set_{points_};
  PointTree tree_;
};

/// Returns roughly how many bytes the planes of this many returns take, at most.
std::uint64_t surface_planes_bytes(std::uint64_t returns);

/// Moves the first n Gaussians of `numbers` ([blocks, kGaussianRows, kGaussianBlock]) towards the
/// planes that SurfacePlanes::at() returns. A call reduces the offset along the normal n by `rate`,
/// in (0, 1], and replaces the covariance C by M C M with M = I - r n n^T. r is `rate`, or less, so
/// that the standard deviation along n stays at least 1e-4 of the distance to the nearest camera.
/// Axes keep their order, as Adam's moments do. The number of threads changes no bit.
void flatten_gaussians(const SurfacePlanes& planes, float rate, std::size_t n, float* numbers,
                       ThreadPool& pool);

}  // namespace redrive
