// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/lidar_ties.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <tuple>

#include "redrive/base/parallel_sort.h"
#include "redrive/math/voxel_grid.h"

namespace redrive {
namespace {

constexpr double kNear_m = 1;           // distance of a point to a return of its patch
constexpr double kPointSigma_m = 0.01;  // deviation of a point from its surface, besides the noise

// A point this near to a return of a patch that faces elsewhere lies in a corner
constexpr double kCorner_m = 0.5;
constexpr double kSameDirection = 0.9;  // cosine above which two patches face the same way
constexpr std::size_t kPerRange = 256;

/// A return of a patch.
struct Return {
  std::uint64_t cell = 0;  ///< key of its voxel of kNear_m
  int patch = 0, sample = 0;
  Eigen::Vector3d in_world;

  bool operator<(const Return& other) const {
    return std::tie(cell, patch, sample) < std::tie(other.cell, other.patch, other.sample);
  }
};

std::vector<Return> returns_by_cell(const RigModel& model, const std::vector<LidarSample>& lidar,
                                    const std::vector<PlanarPatch>& patches, ThreadPool& pool) {
  std::vector<Return> returns;
  for (std::size_t p = 0; p < patches.size(); ++p)
    for (const int i : patches[p].samples) returns.push_back({0, static_cast<int>(p), i, {}});
  pool.run_ranges(returns.size(), kPerRange, [&](std::size_t begin, std::size_t end) {
    for (Return& r : std::span(returns).subspan(begin, end - begin)) {
      const LidarSample& sample = lidar[r.sample];
      r.in_world = model.corrected_pose(model.motion_at(sample.t_ns)) *
                   model.raised(sample.in_body, sample.lidar);
      r.cell = voxel_key(voxel_of(r.in_world, kNear_m));
    }
  });
  sort_in_parallel(&returns, pool);
  return returns;
}

/// Calls use(return, squared distance) for the returns within max_m of the point, up to kNear_m.
template <class Use>
void for_each_near(const std::vector<Return>& returns, const Eigen::Vector3d& point, double max_m,
                   const Use& use) {
  const Voxel centre = voxel_of(point, kNear_m);
  for (int x = -1; x <= 1; ++x)
    for (int y = -1; y <= 1; ++y) {  // cells along z are contiguous
      const std::uint64_t low = voxel_key(centre + Voxel(x, y, -1)),
                          high = voxel_key(centre + Voxel(x, y, 1));
      for (auto at = std::ranges::lower_bound(returns, low, {}, &Return::cell);
           at != returns.end() && at->cell <= high; ++at)
        if (const double squared = (at->in_world - point).squaredNorm(); squared < max_m * max_m)
          use(*at, squared);
    }
}

/// Returns the return nearest to the point; nullptr if there is none, and in corners, where another
/// patch faces elsewhere.
const Return* nearest(const std::vector<Return>& returns, const std::vector<PlanarPatch>& patches,
                      const Eigen::Vector3d& point) {
  const Return* best = nullptr;
  double least = 0;
  for_each_near(returns, point, kNear_m, [&](const Return& r, double squared) {
    if (best && squared >= least) return;
    best = &r;
    least = squared;
  });
  bool corner = false;
  for_each_near(returns, point, best ? kCorner_m : 0, [&](const Return& r, double) {
    corner |=
        std::abs(patches[r.patch].plane.axes.col(2).dot(patches[best->patch].plane.axes.col(2))) <
        kSameDirection;
  });
  return corner ? nullptr : best;
}

}  // namespace

std::optional<Eigen::Vector3d> position_of(const InverseDepthPoint& point, double max_m) {
  const auto [x, y, inverse_m] = point.value;
  if (!(inverse_m * max_m >= 1)) return std::nullopt;
  return point.anchor + point.axes * Eigen::Vector3d(x, y, 1) / inverse_m;
}

std::vector<LidarTie> find_lidar_ties(const RigModel& model, const std::vector<LidarSample>& lidar,
                                      const std::vector<PlanarPatch>& patches,
                                      const std::vector<std::optional<Eigen::Vector3d>>& points,
                                      double max_distance_m, ThreadPool& pool) {
  const std::vector<Return> returns = returns_by_cell(model, lidar, patches, pool);
  std::vector<std::optional<LidarTie>> found(points.size());
  pool.run_ranges(points.size(), kPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Return* const near = points[i] ? nearest(returns, patches, *points[i]) : nullptr;
      if (!near) continue;
      const PlanarPatch& patch = patches[near->patch];
      const PlaneParameters& plane = patch.plane;
      const Eigen::Vector3d steep = plane.axes * Eigen::Vector3d(plane.value[0], plane.value[1], 1),
                            normal = steep.normalized();
      const double distance_m =
          (steep.dot(*points[i] - plane.centre) - plane.value[2]) / steep.norm();
      if (std::abs(distance_m) > max_distance_m) continue;
      LidarTie& tie = found[i].emplace();
      tie.point = i;
      tie.t_ns = lidar[near->sample].t_ns;
      tie.distance_m = distance_m;
      const Rigid3d world_from_body = model.corrected_pose(model.motion_at(tie.t_ns));
      tie.surface = {world_from_body.inverse(Eigen::Isometry) * (*points[i] - distance_m * normal),
                     world_from_body.linear().transpose() * normal,
                     std::hypot(patch.sigma_m, kPointSigma_m)};
    }
  });
  std::vector<LidarTie> ties;
  for (const std::optional<LidarTie>& tie : found)
    if (tie) ties.push_back(*tie);
  return ties;
}

}  // namespace redrive
