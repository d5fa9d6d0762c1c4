// SPDX-License-Identifier: Apache-2.0
// How the car drives along the made road, and the errors of its egomotion.
#pragma once

#include <cstdint>

#include "redrive/math/rigid3.h"
#include "tools/drive/road.h"

namespace redrive::drive {

constexpr double kFrameRate_hz = 10;

/// In the right lane at speed_m_s on average, swaying, braking and pitching a little.
class Motion {
 public:
  /// `road` has to outlive it.
  Motion(const Road& road, double speed_m_s) : road_(road), speed_m_s_(speed_m_s) {}

  /// Body pose t_s after the first frame: x forward, y left, z up, the origin on the road.
  Rigid3d world_from_body(double t_s) const;

 private:
  Eigen::Vector3d position(double t_s) const;
  double along_m(double t_s) const;

  const Road& road_;
  double speed_m_s_;
};

/// Errors of the pose of a frame in body axes: Gaussian, with a squared-exponential correlation of
/// 0.7 s; RMS 6 cm forward and left, 3 cm up, 0.12 degrees about each axis, as tools/street.
Vector6d pose_error(unsigned seed, int frame);

}  // namespace redrive::drive
