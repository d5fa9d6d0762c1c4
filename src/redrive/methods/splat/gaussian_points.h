// SPDX-License-Identifier: Apache-2.0
// Points on surfaces and Gaussians made of them.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include <nanoflann.hpp>

#include "redrive/base/parallel.h"
#include "redrive/image/image.h"
#include "redrive/math/plane_fit.h"
#include "redrive/model/gaussian_layout.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Measures distances to the nearest of the views' cameras, metres.
class NearestCamera {
 public:
  /// `centres`: [n][3].
  explicit NearestCamera(std::vector<float> centres) : centres_(std::move(centres)) {}
  explicit NearestCamera(const Scene& scene);
  float distance(const float* position) const;

 private:
  std::vector<float> centres_;  ///< [n][3]
};

/// A coloured point.
struct Point {
  Eigen::Vector3f position, rgb, seen_from;  ///< rgb in [0, 1]; position of a sensor that saw it
  float intensity = 0;                       ///< 0..1, as a LiDAR measured it
  float returns = 1;                         ///< probability that a LiDAR has a return
  float beyond = 0;                          ///< share of rays that pass it (lidar/rays_beyond.h)
};
using Points = std::vector<Point>;

constexpr float kPointOpacity = 0.5f, kRandomOpacity = 0.1f;  ///< opacity of first Gaussians
constexpr std::size_t kPointsPerRange = 4096;  ///< points that a thread takes at a time

/// Points for nanoflann.
struct PointSet {
  const Points& points;
  std::size_t kdtree_get_point_count() const { return points.size(); }
  float kdtree_get_pt(std::size_t i, std::size_t k) const {
    return points[i].position[static_cast<Eigen::Index>(k)];
  }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};

using PointTree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, PointSet>,
                                                      PointSet, 3, std::uint32_t>;

/// Fits a plane to some of the points.
inline PlaneFit plane_of(const Points& points, std::span<const std::uint32_t> near) {
  return fit_plane(near, [&](std::uint32_t i) { return points[i].position; });
}

/// Returns the colour of pixel `index`, in [0, 1].
Eigen::Vector3f colour_in(const Image8& image, std::size_t index);

/// Returns the mean point of each voxel. The side follows the distance to the nearest camera in
/// steps of sqrt(2); `voxel`: side as a part of that distance.
Points one_per_voxel(const Points& points, const NearestCamera& cameras, float voxel,
                     ThreadPool& pool);

/// Writes a Gaussian without harmonics. scale: standard deviations along its axes, metres;
/// distance: to the nearest camera, metres.
void put_gaussian(const Point& point, const Eigen::Vector3f& scale,
                  const Eigen::Quaternionf& rotation, float opacity, float distance, float* rows);

/// Appends a Gaussian for each point, as large as `size` times the distance of its neighbours, flat
/// where these lie in a plane, and the more transparent, the more rays pass the point; none if
/// there are fewer points than neighbours to look at.
void append_discs(const Points& points, const NearestCamera& cameras, float size, float opacity,
                  ThreadPool& pool, GaussianList* list);

/// Keeps `n` of the Gaussians, chosen and ordered at random.
void shuffle(std::size_t n, std::uint64_t key, GaussianList* list);

}  // namespace redrive
