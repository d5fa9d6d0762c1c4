// SPDX-License-Identifier: Apache-2.0
// The body's pose between the frames (recording/core/trajectory.h), in plain numbers.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>

#include "redrive/math/plain_pose.h"

namespace redrive {

/// A FramePose in plain numbers.
struct PlainFrame {
  std::int64_t t_ns = 0;
  PlainPose global_from_body;
};

/// Returns the pose at t_ns of frames of either kind, as recording/core/trajectory.h.
template <class Frame>
auto pose_at(std::span<const Frame> frames, std::int64_t t_ns) {
  const Frame *const first = frames.data(), *const end = first + frames.size();
  const Frame* after = std::lower_bound(
      first, end, t_ns, [](const Frame& frame, std::int64_t t) { return frame.t_ns < t; });
  if (after != end && after->t_ns == t_ns) return after->global_from_body;
  if (frames.size() == 1) return first->global_from_body;
  after = after == first ? first + 1 : after == end ? end - 1 : after;
  const Frame &b = *after, &a = *(after - 1);
  const double u = static_cast<double>(t_ns - a.t_ns) / static_cast<double>(b.t_ns - a.t_ns);
  return interpolate(a.global_from_body, b.global_from_body, u);
}

}  // namespace redrive
