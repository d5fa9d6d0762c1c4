// SPDX-License-Identifier: Apache-2.0
// Where a camera is while it exposes a picture: in one place, or, with a rolling shutter, in another for each row.
#pragma once

#include <vector>

#include "redrive/math/rigid3.h"

namespace redrive {

/// When row v of a picture (0 the middle of the first one) is exposed: 0 with the upper edge, 1 with the lower one.
inline double row_part(double v, int height) { return (v + 0.5) / height; }

class ShutterPoses {
 public:
  ShutterPoses(const Rigid3d& pose) : keys_{pose} {}  // NOLINT: a pose is what most pictures have
  /// At evenly spaced times from the upper edge of the picture to the lower one; at least one.
  explicit ShutterPoses(std::vector<Rigid3d> keys);

  bool rolls() const { return keys_.size() > 1; }
  const Rigid3d& first() const { return keys_.front(); }
  /// 0 the upper edge, 1 the lower one; between two keys as recording/trajectory.h: straight on, and the shortest turn.
  Rigid3d at(double row) const;
  /// The middle of row y of a picture.
  Rigid3d at_row(int y, int height) const { return rolls() ? at(row_part(y, height)) : first(); }

 private:
  std::vector<Rigid3d> keys_;
};

}  // namespace redrive
