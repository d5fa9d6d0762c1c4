// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/actors/articulated.h"

#include <algorithm>
#include <cmath>

#include "redrive/perception/moving_file.h"
#include "redrive/recording/core/actor_kind.h"

namespace redrive {
namespace {

constexpr int kAlong = 3, kUp = 5;  // cells of the box along its length and height
static_assert(kArticulatedParts == 1 + kAlong * kUp);
static_assert(kMiddlePart == 1 + kUp / 2 * kAlong + kAlong / 2 && kUp % 2 == 1 && kAlong % 2 == 1);
constexpr double kOnRoad_m = 0.06;  // up to here above the box's lower side
// largest box that nobody annotated of somebody who walks or rides
constexpr double kMostLength_m = 2.4, kMostWidth_m = 1.2;

/// Index of the cell, of n along a side of this size, that holds a coordinate, or of the nearest.
int cell_of(double coordinate, double size_m, int n) {
  const double part = coordinate / std::max(size_m, 1e-6) + 0.5;
  return std::clamp(static_cast<int>(std::floor(part * n)), 0, n - 1);
}

}  // namespace

bool is_articulated(const MovingObject& object) {
  if (object.type == kFound)
    return object.size_m.x() <= kMostLength_m && object.size_m.y() <= kMostWidth_m;
  return kind_of(object.type).core == 0;
}

std::vector<GaussianList> divided(const GaussianList& list, const Eigen::Vector3d& size_m) {
  std::vector<GaussianList> parts(kArticulatedParts);
  for (std::size_t i = 0; i < list.size(); ++i) {
    const float* const row = &list.rows[i * kGaussianRows];
    const double x = row[kPositionRow], z = row[kPositionRow + 2];
    const bool on_road = z < kOnRoad_m - size_m.z() / 2;
    const int cell = cell_of(z, size_m.z(), kUp) * kAlong + cell_of(x, size_m.x(), kAlong);
    GaussianList& part = parts[on_road ? 0 : 1 + static_cast<std::size_t>(cell)];
    part.rows.insert(part.rows.end(), row, row + kGaussianRows);
  }
  return parts;
}

Eigen::Vector3d pivot_of(std::size_t part, const Eigen::Vector3d& size_m) {
  if (part == 0) return Eigen::Vector3d::Zero();
  const auto cell = static_cast<int>(part) - 1;
  return {((cell % kAlong + 0.5) / kAlong - 0.5) * size_m.x(), 0,
          ((cell / kAlong + 0.5) / kUp - 0.5) * size_m.z()};
}

}  // namespace redrive
