// SPDX-License-Identifier: Apache-2.0
// The pose of a camera during an exposure: one, or, with a rolling shutter, one per row.
#pragma once

#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/math/shutter_row.h"

namespace redrive {

class ShutterPoses {
 public:
  ShutterPoses(const Rigid3d& pose) : keys_{plain(pose)} {}  // NOLINT: most images have one pose
  /// `keys`: at evenly spaced times from the upper edge of the image to the lower one; at least
  /// one.
  explicit ShutterPoses(const std::vector<Rigid3d>& keys);

  bool is_rolling() const { return keys_.size() > 1; }
  const std::vector<PlainPose>& keys() const { return keys_; }
  /// `row`: 0 at the upper edge, 1 at the lower one (pose_at_row).
  Rigid3d at(double row) const { return rigid(pose_at_row(keys_.data(), keys_.size(), row)); }
  /// Returns the pose at the middle of row y.
  Rigid3d at_row(int y, int height) const { return at(row_fraction(y, height)); }

 private:
  std::vector<PlainPose> keys_;
};

}  // namespace redrive
