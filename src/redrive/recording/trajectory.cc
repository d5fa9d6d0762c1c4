// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/trajectory.h"

#include "redrive/base/error.h"
#include "redrive/math/plain_trajectory.h"

namespace redrive {

Rigid3d pose_at(const std::vector<FramePose>& frames, std::int64_t t_ns) {
  REDRIVE_CHECK(!frames.empty());
  return pose_at(std::span(frames), t_ns);
}

}  // namespace redrive
