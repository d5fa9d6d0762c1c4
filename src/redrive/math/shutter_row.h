// SPDX-License-Identifier: Apache-2.0
// The pose of a camera while it exposes a row or column of an image, in plain numbers
// (scene/shutter_poses.h).
#pragma once

#include <cstddef>

#include "redrive/math/plain_pose.h"

namespace redrive {

/// Returns the exposure time of row v (0: the middle of the first row) as a fraction of the
/// readout: 0 at the upper edge, 1 at the lower one.
inline double row_fraction(double v, int height) { return (v + 0.5) / height; }

/// The same for a pixel (u, v) of an image that is exposed row by row, or `by_column`: 0 at the
/// left edge, 1 at the right one.
inline double line_fraction(bool by_column, double u, double v, int width, int height) {
  return by_column ? (u + 0.5) / width : row_fraction(v, height);
}

/// Returns the pose at `row` in 0..1 from n poses at evenly spaced times, from the upper edge (0)
/// to the lower one (1), by linear interpolation and slerp between neighbours. A single pose holds
/// for all rows.
inline PlainPose pose_at_row(const PlainPose* keys, std::size_t n, double row) {
  if (n == 1) return keys[0];
  const double position = (row < 0 ? 0 : row > 1 ? 1 : row) * static_cast<double>(n - 1);
  const std::size_t key = static_cast<std::size_t>(position), before = key < n - 2 ? key : n - 2;
  return interpolate(keys[before], keys[before + 1], position - static_cast<double>(before));
}

}  // namespace redrive
