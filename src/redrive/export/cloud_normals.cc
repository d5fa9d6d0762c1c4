// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/cloud_normals.h"

#include <nanoflann.hpp>

#include "redrive/base/error.h"
#include "redrive/math/plane_fit.h"

namespace redrive {
namespace {

constexpr std::size_t kNearest = 12;
// Points on one line of a LiDAR determine no plane.
constexpr double kLeastWidth = 1e-3f;  // squared, of the squared length

/// Points for nanoflann.
struct CloudPoints {
  std::span<const PlyPoint> points;
  std::size_t kdtree_get_point_count() const { return points.size(); }
  float kdtree_get_pt(std::size_t i, std::size_t k) const {
    return points[i].position[static_cast<Eigen::Index>(k)];
  }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};

}  // namespace

void estimate_normals(std::span<const Eigen::Vector3f> seen_from, ThreadPool& pool,
                      std::span<PlyPoint> points) {
  REDRIVE_CHECK_OP(seen_from.size(), ==, points.size());
  for (PlyPoint& point : points) point.normal.setZero();
  if (points.size() < kNearest) return;
  const CloudPoints set{points};
  nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, CloudPoints>, CloudPoints,
                                      3, std::uint32_t>
      tree(3, set, nanoflann::KDTreeSingleIndexAdaptorParams(16));
  tree.buildIndex();
  constexpr std::size_t kPointsPerRange = 4096;
  pool.run_ranges(points.size(), kPointsPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      std::array<std::uint32_t, kNearest> near;
      std::array<float, kNearest> squares;
      tree.knnSearch(points[i].position.data(), kNearest, near.data(), squares.data());
      const PlaneFit plane = fit_plane(near, [&](std::uint32_t j) { return points[j].position; });
      if (!(plane.variance[1] > kLeastWidth * plane.variance[2])) continue;
      const Eigen::Vector3f normal = plane.normal().cast<float>();
      const bool away = normal.dot(seen_from[i] - points[i].position) < 0;
      points[i].normal = away ? Eigen::Vector3f(-normal) : normal;
    }
  });
}

}  // namespace redrive
