// SPDX-License-Identifier: Apache-2.0
// Where a camera is while it exposes a row of a picture, in plain numbers (scene/shutter_poses.h).
#pragma once

#include <cstddef>

#include "redrive/math/plain_pose.h"

namespace redrive {

/// When row v of a picture (0 the middle of the first one) is exposed: 0 with the upper edge, 1
/// with the lower one.
REDRIVE_HD inline double row_fraction(double v, int height) { return (v + 0.5) / height; }

/// By n poses at evenly spaced times from the upper edge (row 0) to the lower one (1); between two
/// of them as recording/trajectory.h: straight on, and the shortest turn. A single one is that of
/// all rows.
REDRIVE_HD inline PlainPose pose_at_row(const PlainPose* keys, std::size_t n, double row) {
  if (n == 1) return keys[0];
  const double place = (row < 0 ? 0 : row > 1 ? 1 : row) * static_cast<double>(n - 1);
  const std::size_t key = static_cast<std::size_t>(place), before = key < n - 2 ? key : n - 2;
  return between(keys[before], keys[before + 1], place - static_cast<double>(before));
}

}  // namespace redrive
