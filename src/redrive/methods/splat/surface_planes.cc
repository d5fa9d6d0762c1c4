// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/surface_planes.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>

namespace redrive {
namespace {

// "Distance" is the distance to the nearest training camera.
constexpr std::size_t kMostReturns = 1'000'000;  // evenly spaced in the order of the returns
constexpr float kVoxel = 0.03f;                  // side over distance
constexpr std::size_t kPlaneNeighbours = 16;
/// Largest RMS residual of the neighbours: metres + a part of the distance.
constexpr float kResidual_m = 0.03f, kRelativeResidual = 0.002f;
constexpr float kFlatness = 0.15f;  // largest RMS residual over the smaller RMS extent in the plane
/// Largest offset of a Gaussian from its plane: metres, or a part of the distance if that is more.
constexpr float kOffset_m = 0.1f, kRelativeOffset = 0.01f;
constexpr double kThinnest = 1e-4;  // standard deviation of a Gaussian over distance

Points thinned(const Scene& scene, const LidarReturns& lidar, ThreadPool& pool) {
  const std::size_t every = (lidar.n + kMostReturns - 1) / kMostReturns;
  Points points;
  points.reserve(lidar.n / std::max<std::size_t>(every, 1) + 1);
  LidarPoses poses(scene, lidar, Poses::kRecorded);
  for (std::size_t i = 0; i < lidar.n; i += every)
    points.push_back({poses.in_world(i).cast<float>(), Eigen::Vector3f::Zero(),
                      poses.at(i).translation().cast<float>()});
  return one_per_voxel(points, NearestCamera(scene), kVoxel, pool);
}

/// Returns the eigenvectors as a rotation, permuted and with the signs that bring them nearest to
/// the axes `before`. order: [k] is the column of axis k in `eigenvectors`.
Eigen::Matrix3d aligned_axes(const Eigen::Matrix3d& eigenvectors, const Eigen::Matrix3d& before,
                             std::array<int, 3>* order) {
  const Eigen::Matrix3d overlap = before.transpose() * eigenvectors;
  std::array<int, 3> trial = {0, 1, 2};
  double best = -1;
  do {
    double sum = 0;
    for (int k = 0; k < 3; ++k) sum += std::fabs(overlap(k, trial[k]));
    if (sum > best) {
      best = sum;
      *order = trial;
    }
  } while (std::ranges::next_permutation(trial).found);
  Eigen::Matrix3d out;
  int least = 0;  // the axis with the smallest overlap, whose sign is the least certain
  for (int k = 0; k < 3; ++k) {
    const double along = overlap(k, (*order)[k]);
    out.col(k) = std::copysign(1.0, along) * eigenvectors.col((*order)[k]);
    if (std::fabs(along) < std::fabs(overlap(least, (*order)[least]))) least = k;
  }
  if (out.determinant() < 0) out.col(least) *= -1;
  return out;
}

/// Moves Gaussian i towards its plane, as flatten_gaussians() describes.
void flatten(const SurfacePlane& plane, float rate, std::size_t i, float* numbers) {
  const auto at = [&](int row) -> float& { return numbers[gaussian_slot(i, row)]; };
  const Eigen::Vector3f position(at(kPositionRow), at(kPositionRow + 1), at(kPositionRow + 2));
  const float offset = plane.normal.dot(position - plane.mean);
  for (int k = 0; k < 3; ++k) at(kPositionRow + k) -= rate * offset * plane.normal[k];

  const Eigen::Quaterniond stored(double(at(kQuaternionRow)), double(at(kQuaternionRow + 1)),
                                  double(at(kQuaternionRow + 2)), double(at(kQuaternionRow + 3)));
  const Eigen::Matrix3d axes = stored.normalized().toRotationMatrix();
  Eigen::Matrix3d scaled = axes;
  for (int k = 0; k < 3; ++k) scaled.col(k) *= std::exp(double(at(kLogScaleRow + k)));
  const Eigen::Vector3d normal = plane.normal.cast<double>();
  const double thickness = (scaled.transpose() * normal).norm(),
               least = kThinnest * double(at(kDistanceRow));
  if (thickness <= least) return;
  const double thinner = std::max(1 - double(rate), least / thickness);
  scaled -= (1 - thinner) * normal * (normal.transpose() * scaled);
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(scaled * scaled.transpose());
  std::array<int, 3> order;
  const Eigen::Quaterniond turned(aligned_axes(solver.eigenvectors(), axes, &order));
  const double length = stored.norm();
  for (int k = 0; k < 3; ++k) {
    // Rounding may make an eigenvalue too small: no axis gets thinner than `least`, unless it was.
    const double was = std::exp(double(at(kLogScaleRow + k)));
    const double variance =
        std::max(solver.eigenvalues()[order[k]], std::pow(std::min(was, least), 2));
    at(kLogScaleRow + k) = static_cast<float>(std::log(variance) / 2);
  }
  at(kQuaternionRow) = static_cast<float>(length * turned.w());
  at(kQuaternionRow + 1) = static_cast<float>(length * turned.x());
  at(kQuaternionRow + 2) = static_cast<float>(length * turned.y());
  at(kQuaternionRow + 3) = static_cast<float>(length * turned.z());
}

}  // namespace

SurfacePlanes::SurfacePlanes(const Scene& scene, const LidarReturns& lidar, ThreadPool& pool)
    : points_(thinned(scene, lidar, pool)),
      planes_(points_.size()),
      tree_(3, set_, nanoflann::KDTreeSingleIndexAdaptorParams(16)) {
  if (points_.size() < kPlaneNeighbours) return;
  tree_.buildIndex();
  const NearestCamera cameras(scene);
  pool.run_ranges(points_.size(), kPointsPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3f& position = points_[i].position;
      std::array<std::uint32_t, kPlaneNeighbours> near;
      std::array<float, kPlaneNeighbours> squares;
      tree_.knnSearch(position.data(), kPlaneNeighbours, near.data(), squares.data());
      const PlaneFit plane = plane_of(points_, near);
      const Eigen::Vector3f extent = plane.extent().cast<float>();
      const float residual = kResidual_m + kRelativeResidual * cameras.distance(position.data());
      if (extent[0] > std::min(residual, kFlatness * extent[1])) continue;
      planes_[i] = {plane.mean.cast<float>(), plane.normal().cast<float>(),
                    std::sqrt(squares.back())};
    }
  });
}

const SurfacePlane* SurfacePlanes::at(const Eigen::Vector3f& position, float distance) const {
  if (points_.size() < kPlaneNeighbours) return nullptr;
  std::uint32_t nearest;
  float square;
  tree_.knnSearch(position.data(), 1, &nearest, &square);
  const SurfacePlane& plane = planes_[nearest];
  if (square >= plane.radius_m * plane.radius_m) return nullptr;
  const float offset = plane.normal.dot(position - plane.mean);
  return std::fabs(offset) < std::max(kOffset_m, kRelativeOffset * distance) ? &plane : nullptr;
}

std::uint64_t surface_planes_bytes(std::uint64_t returns) {
  constexpr std::uint64_t kTree = 16;  // bytes of the k-d tree for each point
  return std::min<std::uint64_t>(returns, kMostReturns) *
         (sizeof(Point) + sizeof(SurfacePlane) + kTree);
}

void flatten_gaussians(const SurfacePlanes& planes, float rate, std::size_t n, float* numbers,
                       ThreadPool& pool) {
  pool.run_ranges(n, kPointsPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3f position(numbers[gaussian_slot(i, kPositionRow)],
                                     numbers[gaussian_slot(i, kPositionRow + 1)],
                                     numbers[gaussian_slot(i, kPositionRow + 2)]);
      const float distance = numbers[gaussian_slot(i, kDistanceRow)];
      if (const SurfacePlane* plane = planes.at(position, distance))
        flatten(*plane, rate, i, numbers);
    }
  });
}

}  // namespace redrive
