// SPDX-License-Identifier: Apache-2.0
// Rays of a group as pixels of a raster (kernels/gaussian/gaussian_stages.h), whose Gaussians are
// seen by the spherical projection (camera/lenses/spherical.h; Hess et al., SplatAD, CVPR 2025).
// The raster's origin moves evenly with the azimuth, as a spinning sensor's does for a quarter of a
// turn.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/math/rigid3.h"
#include "redrive/methods/splat/lidar/ray_groups.h"

namespace redrive {

/// Full width of a beam, rad: data sheets of common sensors have 2 to 3 mrad.
constexpr double kBeam_rad = 3e-3;

class RayRaster {
 public:
  /// beam_rad: > 0, full width of the rays; a Gaussian that is narrower covers a part of them.
  explicit RayRaster(const RayGroup& group, double beam_rad = kBeam_rad);

  /// Refers to this and to `parts`, each with one pose for each of key_poses().
  kernels::GaussianCamera camera(std::span<const kernels::GaussianPart> parts = {}) const;
  kernels::RasterSize size() const;
  /// The sensor's poses at the first and the last ray's azimuth, or one, and their times.
  const std::vector<PlainPose>& key_poses() const { return poses_; }
  const std::vector<std::int64_t>& key_times() const { return times_; }
  /// Index in a plane of the raster for each ray of the group.
  const std::vector<std::uint32_t>& places() const { return place_; }

 private:
  double per_radian_;
  int tiles_x_ = 0, tiles_y_ = 0;
  std::vector<float> u_, v_;  ///< planes of centres
  std::vector<std::uint32_t> place_;
  std::array<float, 2> key_azimuths_;
  std::vector<PlainPose> poses_;
  std::vector<std::int64_t> times_;
};

}  // namespace redrive
