// SPDX-License-Identifier: Apache-2.0
// LiDAR scans in parts, each of which a training step renders.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/kernels/rays.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

/// Rays of a part of a scan, fired within a part of its time, or where all have one time, to one
/// side. Of two returns of a ray it has the stronger.
struct ScanWindow {
  std::vector<float> origin, direction;  ///< [3, n] in the world by the current poses, unit
  std::vector<float> log_range;          ///< [n] log metres; kernels::kNoRange: nothing came back
  std::vector<float> intensity;          ///< [n] 0..1
  std::vector<std::int64_t> t_ns;        ///< [n]
  /// Columns: x, y, z, with y down and z towards the middle of the rays.
  Eigen::Matrix3d world_from_axes = Eigen::Matrix3d::Identity();

  kernels::Rays rays() const { return {static_cast<int>(t_ns.size()), origin, direction, t_ns}; }
};

class ScanWindows {
 public:
  /// `scene` and `lidar` must outlive this. `drawn`: whether a moving object is drawn, by its id;
  /// rays to others are left out.
  ScanWindows(const Scene& scene, const LidarReturns& lidar,
              std::function<bool(std::int64_t)> drawn);
  /// 0 for point clouds.
  std::size_t size() const { return windows_.size(); }
  ScanWindow operator[](std::size_t window) const;

 private:
  struct Window {
    std::size_t scan;
    int part, parts;  ///< index and number of the scan's parts
  };
  struct Scan {
    LidarReturns::ScanEnd begin, end;
    std::int64_t first_ns, last_ns;
  };
  /// Returns where in its scan a ray belongs, from 0 to below 1.
  float part_of(const Scan& scan, std::int64_t t_ns, const Eigen::Vector3f& direction) const;

  const Scene& scene_;
  const LidarReturns& lidar_;
  std::function<bool(std::int64_t)> drawn_;
  std::vector<float> full_intensities_;
  std::vector<Scan> scans_;
  std::vector<Window> windows_;
};

}  // namespace redrive
