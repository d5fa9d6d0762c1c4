// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/shutter_poses.h"

#include "redrive/base/error.h"

namespace redrive {

ShutterPoses::ShutterPoses(const std::vector<Rigid3d>& keys) {
  REDRIVE_CHECK(!keys.empty());
  for (const Rigid3d& key : keys) keys_.push_back(plain(key));
}

}  // namespace redrive
