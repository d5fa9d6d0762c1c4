// SPDX-License-Identifier: Apache-2.0
// Directions in which the vehicle itself is in a LiDAR's way.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include <Eigen/Core>

namespace redrive {

/// A set of cells, half a degree of elevation by one of azimuth, of unit vectors in the body's
/// axes, from the sensor's place.
class BlindDirections {
 public:
  static constexpr std::size_t kRows = 360, kColumns = 360, kCells = kRows * kColumns;

  static std::size_t cell_of(const Eigen::Vector3d& direction) {
    constexpr double kHalfTurn_rad = std::numbers::pi;
    const auto index = [](double share, std::size_t n) {
      return std::min(static_cast<std::size_t>(share * static_cast<double>(n)), n - 1);
    };
    const double elevation_rad = std::asin(std::clamp(direction.z(), -1.0, 1.0)),
                 azimuth_rad = std::atan2(direction.y(), direction.x());
    return index(0.5 + elevation_rad / kHalfTurn_rad, kRows) * kColumns +
           index(0.5 + 0.5 * azimuth_rad / kHalfTurn_rad, kColumns);
  }

  bool empty() const { return blind_.empty(); }
  bool contains(const Eigen::Vector3d& direction) const {
    return !empty() && blind_[cell_of(direction)];
  }
  std::size_t cells() const {
    return static_cast<std::size_t>(std::count(blind_.begin(), blind_.end(), true));
  }
  void insert(std::size_t cell) {
    if (empty()) blind_.resize(kCells);
    blind_[cell] = true;
  }

  /// Runs of cells in their order: the first one and their number.
  using Run = std::array<std::size_t, 2>;
  std::vector<Run> runs() const {
    std::vector<Run> out;
    for (std::size_t i = 0; i < blind_.size(); ++i) {
      if (!blind_[i]) continue;
      if (out.empty() || out.back()[0] + out.back()[1] < i) out.push_back({i, 0});
      ++out.back()[1];
    }
    return out;
  }

  bool operator==(const BlindDirections&) const = default;

 private:
  std::vector<bool> blind_;  ///< [kCells]; empty: none is
};

}  // namespace redrive
