// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/gaussian_points.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Geometry>

#include "redrive/base/rng.h"
#include "redrive/math/voxel_grid.h"
#include "redrive/scene/point_cloud.h"

namespace redrive {
namespace {

constexpr std::size_t kNeighbours = 9;
/// Least scale of a disc along its normal, as a part of its smaller axis.
constexpr float kFlattest = 0.15f;
/// Least share of rays that counts as ended at a point.
constexpr float kLeastEnded = 0.05f;

float logit(float p) { return std::log(p / (1 - p)); }

}  // namespace

Eigen::Vector3f colour_in(const Image8& image, std::size_t index) {
  const auto rgb = colour_at(image, index);
  return Eigen::Vector3f(rgb[0], rgb[1], rgb[2]) / 255;
}

Points one_per_voxel(const Points& points, const NearestCamera& cameras, float voxel,
                     ThreadPool& pool) {
  std::vector<std::uint64_t> keys(points.size());
  pool.run_ranges(points.size(), kPointsPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const float side = std::max(voxel * cameras.distance(points[i].position.data()), 1e-6f);
      const int level = static_cast<int>(std::floor(2 * std::log2(side)));
      const float step = std::exp2(0.5f * static_cast<float>(level));
      keys[i] = mix64(static_cast<std::uint64_t>(level + 1000));  // levels mix all bits of a key
      for (const std::int64_t index : voxel_of(points[i].position, step))
        keys[i] = mix64(keys[i] ^ static_cast<std::uint64_t>(index));
    }
  });
  const VoxelGroups voxels(keys, &pool);
  Points out;
  for (std::size_t v = 0; v < voxels.size(); ++v) {
    Point sum{Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero(), points[voxels[v][0]].seen_from};
    for (const std::uint32_t i : voxels[v]) {
      sum.position += points[i].position;
      sum.rgb += points[i].rgb;
      sum.intensity += points[i].intensity;
    }
    const auto n = static_cast<float>(voxels[v].size());
    out.push_back({sum.position / n, sum.rgb / n, sum.seen_from, sum.intensity / n});
  }
  return out;
}

void put_gaussian(const Point& point, const Eigen::Vector3f& scale,
                  const Eigen::Quaternionf& rotation, float opacity, float distance, float* rows) {
  std::fill_n(rows, kGaussianRows, 0.0f);
  for (int k = 0; k < 3; ++k) {
    rows[kPositionRow + k] = point.position[k];
    rows[kLogScaleRow + k] = std::log(scale[k]);
    rows[kColourRow + k] = point.rgb[k];
  }
  rows[kQuaternionRow] = rotation.w();
  rows[kQuaternionRow + 1] = rotation.x();
  rows[kQuaternionRow + 2] = rotation.y();
  rows[kQuaternionRow + 3] = rotation.z();
  rows[kOpacityRow] = logit(opacity);
  rows[kLidarRow + 2 * kIntensitySlot] = point.intensity;
  rows[kLidarRow + 2 * kReturnSlot] = point.returns;
  rows[kDistanceRow] = distance;
}

void append_discs(const Points& points, const NearestCamera& cameras, float size, float opacity,
                  ThreadPool& pool, GaussianList* list) {
  if (points.size() <= kNeighbours) return;
  const PointSet set{points};
  PointTree tree(3, set, nanoflann::KDTreeSingleIndexAdaptorParams(16));
  tree.buildIndex();
  const std::size_t first = list->size();
  list->rows.resize((first + points.size()) * kGaussianRows);
  pool.run_ranges(points.size(), kPointsPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      std::array<std::uint32_t, kNeighbours> near;
      std::array<float, kNeighbours> squares;
      tree.knnSearch(points[i].position.data(), kNeighbours, near.data(), squares.data());
      const PlaneFit plane = plane_of(points, near);
      Eigen::Matrix3f rotation;
      rotation.col(0) = plane.axes.col(2).cast<float>();
      rotation.col(1) = plane.axes.col(1).cast<float>();
      rotation.col(2) = rotation.col(0).cross(rotation.col(1));
      const float distance = cameras.distance(points[i].position.data());
      const float side =
          (std::sqrt(squares[1]) + std::sqrt(squares[2]) + std::sqrt(squares[3])) / 3;
      const float scale = std::clamp(size * side, 5e-4f * distance, 0.02f * distance);
      const double thickness = std::sqrt(plane.variance[0] / std::max(plane.variance[1], 1e-20));
      const float flat = std::clamp(2 * static_cast<float>(thickness), kFlattest, 1.0f);
      const float seen = opacity * std::max(1 - points[i].beyond, kLeastEnded);
      put_gaussian(points[i], {scale, scale, flat * scale}, Eigen::Quaternionf(rotation), seen,
                   distance, &list->rows[(first + i) * kGaussianRows]);
    }
  });
}

void shuffle(std::size_t n, std::uint64_t key, GaussianList* list) {
  std::vector<std::pair<std::uint64_t, std::uint32_t>> order(list->size());
  for (std::size_t i = 0; i < order.size(); ++i)
    order[i] = {random_bits(key, i), static_cast<std::uint32_t>(i)};
  std::ranges::sort(order);
  order.resize(std::min(n, order.size()));
  GaussianList kept;
  kept.rows.reserve(order.size() * kGaussianRows);
  for (const auto& [unused, i] : order)
    kept.rows.insert(kept.rows.end(), &list->rows[i * std::size_t{kGaussianRows}],
                     &list->rows[i * std::size_t{kGaussianRows}] + kGaussianRows);
  *list = std::move(kept);
}

NearestCamera::NearestCamera(const Scene& scene) {
  // Neighbouring frames are centimetres to metres apart: this many cameras represent all.
  constexpr std::size_t kMost = 64;
  const std::size_t n = scene.views.size(), every = (n + kMost - 1) / kMost;
  for (std::size_t i = 0; i < n; i += every) {
    const Eigen::Vector3d centre = scene.world_from_camera(scene.views[i]).translation();
    for (int k = 0; k < 3; ++k) centres_.push_back(static_cast<float>(centre[k]));
  }
}

float NearestCamera::distance(const float* position) const {
  float least = std::numeric_limits<float>::max();
  for (std::size_t i = 0; i < centres_.size(); i += 3) {
    const float x = position[0] - centres_[i], y = position[1] - centres_[i + 1],
                z = position[2] - centres_[i + 2];
    least = std::min(least, x * x + y * y + z * z);
  }
  return std::sqrt(least);
}

}  // namespace redrive
