// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/shutter_poses.h"

#include <algorithm>

#include "redrive/base/error.h"

namespace redrive {

ShutterPoses::ShutterPoses(std::vector<Rigid3d> keys) : keys_(std::move(keys)) { REDRIVE_CHECK(!keys_.empty()); }

Rigid3d ShutterPoses::at(double row) const {
  if (!rolls()) return keys_[0];
  const double place = std::clamp(row, 0.0, 1.0) * static_cast<double>(keys_.size() - 1);
  const std::size_t before = std::min(static_cast<std::size_t>(place), keys_.size() - 2);
  return between(keys_[before], keys_[before + 1], place - static_cast<double>(before));
}

}  // namespace redrive
