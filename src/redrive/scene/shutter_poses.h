// SPDX-License-Identifier: Apache-2.0
// Where a camera is while it exposes a picture: in one place, or, with a rolling shutter, in
// another for each row.
#pragma once

#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/math/shutter_row.h"

namespace redrive {

class ShutterPoses {
 public:
  ShutterPoses(const Rigid3d& pose)
      : keys_{plain(pose)} {}  // NOLINT: a pose is what most pictures have
  /// At evenly spaced times from the upper edge of the picture to the lower one; at least one.
  explicit ShutterPoses(const std::vector<Rigid3d>& keys);

  bool is_rolling() const { return keys_.size() > 1; }
  const std::vector<PlainPose>& keys() const { return keys_; }
  /// 0 the upper edge, 1 the lower one (pose_at_row).
  Rigid3d at(double row) const { return rigid(pose_at_row(keys_.data(), keys_.size(), row)); }
  /// The middle of row y of a picture.
  Rigid3d at_row(int y, int height) const { return at(row_fraction(y, height)); }

 private:
  std::vector<PlainPose> keys_;
};

}  // namespace redrive
