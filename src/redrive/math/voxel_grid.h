// SPDX-License-Identifier: Apache-2.0
// Voxels: cubes of a grid whose corners are multiples of the side. Voxel v holds the points p with
// v = floor(p / side).
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "redrive/base/parallel_sort.h"

namespace redrive {

using Voxel = Eigen::Matrix<std::int64_t, 3, 1>;

/// Returns the voxel that holds a finite point, in the point's own precision.
template <class Point>
Voxel voxel_of(const Eigen::MatrixBase<Point>& point, typename Point::Scalar side) {
  return (point / side).array().floor().template cast<std::int64_t>();
}

/// Packs a voxel, 21 bits a coordinate. Keys are ordered by x, then y, then z. Voxels whose
/// coordinates differ by multiples of 2^21 share a key.
inline std::uint64_t voxel_key(const Voxel& voxel) {
  std::uint64_t key = 0;
  for (int k = 0; k < 3; ++k)
    key = key << 21 | (static_cast<std::uint64_t>(voxel[k] + (1 << 20)) & 0x1fffff);
  return key;
}

/// Returns the voxel of a key, each coordinate in [-2^20, 2^20).
inline Voxel voxel_of_key(std::uint64_t key) {
  Voxel voxel;
  for (int k = 2; k >= 0; --k, key >>= 21)
    voxel[k] = static_cast<std::int64_t>(key & 0x1fffff) - (1 << 20);
  return voxel;
}

/// Points by voxel: voxels in the order of their keys, the points of each in their own order.
class VoxelGroups {
 public:
  /// keys[i] belongs to point i: any numbers that are equal for points of one voxel. Sorts on the
  /// threads of `pool`, if there is one.
  explicit VoxelGroups(std::span<const std::uint64_t> keys, ThreadPool* pool = nullptr) {
    std::vector<std::pair<std::uint64_t, std::uint32_t>> sorted(keys.size());
    for (std::size_t i = 0; i < keys.size(); ++i)
      sorted[i] = {keys[i], static_cast<std::uint32_t>(i)};
    if (pool)
      sort_in_parallel(&sorted, *pool);
    else
      std::ranges::sort(sorted);
    points_.reserve(keys.size());
    for (std::size_t i = 0; i < sorted.size(); ++i) {
      if (i == 0 || sorted[i].first != sorted[i - 1].first) first_.push_back(i);
      points_.push_back(sorted[i].second);
    }
    first_.push_back(sorted.size());
  }

  std::size_t size() const { return first_.size() - 1; }
  /// Indices of the points of a voxel, ascending, at least one.
  std::span<const std::uint32_t> operator[](std::size_t voxel) const {
    return std::span(points_).subspan(first_[voxel], first_[voxel + 1] - first_[voxel]);
  }

 private:
  std::vector<std::uint32_t> points_;
  std::vector<std::size_t> first_;  ///< into points_, by voxel, and their number
};

}  // namespace redrive
