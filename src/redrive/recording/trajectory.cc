// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/trajectory.h"

#include <algorithm>

#include "redrive/base/error.h"

namespace redrive {

Rigid3d pose_at(const std::vector<FramePose>& frames, std::int64_t t_ns) {
  REDRIVE_CHECK(!frames.empty());
  auto after = std::lower_bound(frames.begin(), frames.end(), t_ns,
                                [](const FramePose& frame, std::int64_t t) { return frame.t_ns < t; });
  if (after != frames.end() && after->t_ns == t_ns) return after->ecef_from_body;
  if (frames.size() == 1) return frames.front().ecef_from_body;
  after = std::clamp(after, frames.begin() + 1, frames.end() - 1);
  const FramePose &b = *after, &a = *(after - 1);
  const double u = static_cast<double>(t_ns - a.t_ns) / static_cast<double>(b.t_ns - a.t_ns);
  return between(a.ecef_from_body, b.ecef_from_body, u);
}

}  // namespace redrive
