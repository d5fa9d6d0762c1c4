// SPDX-License-Identifier: Apache-2.0
// The pose from which a camera sees a pixel, in double.
#pragma once

#include <span>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/math/shutter_row.h"

namespace redrive::kernels {

/// Number of projections that find the line of a Gaussian's mean: the line determines the pose and
/// the pose the line.
inline int line_iterations(std::span<const PlainPose> poses) { return poses.size() > 1 ? 3 : 1; }
/// The same of a point (GaussianStages::project_points), which is found more exactly.
inline int point_iterations(std::span<const PlainPose> poses) {
  return line_iterations(poses) + (poses.size() > 1 ? 1 : 0);
}

/// Returns the pose of the line on which `mean` (u, v) lies.
inline GaussianPose<NumberMath<double>> line_pose(const GaussianCamera& camera,
                                                  std::span<const PlainPose> poses,
                                                  const double* mean) {
  const double v = mean[camera.by_column ? 0 : 1],
               row = (v + 0.5 + static_cast<double>(camera.first_row)) /
                     static_cast<double>(camera.image_rows);
  const PlainPose pose = pose_at_row(poses.data(), poses.size(), row);
  GaussianPose<NumberMath<double>> out;
  for (int k = 0; k < 9; ++k) out.rotation[k] = pose.rotation[3 * (k % 3) + k / 3];
  for (int k = 0; k < 3; ++k) out.centre[k] = pose.translation[k];
  return out;
}

}  // namespace redrive::kernels
