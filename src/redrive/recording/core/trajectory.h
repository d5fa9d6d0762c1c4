// SPDX-License-Identifier: Apache-2.0
// The body's trajectory: its pose between the frames, for cameras and LiDAR points with their own
// times, and the check of a file's poses.
#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// Returns global_from_body at time t_ns: between two frames the position is interpolated linearly
/// and the rotation along the shortest arc; before the first and after the last frame the motion
/// between the two frames there continues. `frames`: at least one, times increasing; a single one
/// stands still. At a frame's own time its own pose, bit for bit.
Rigid3d pose_at(const std::vector<FramePose>& frames, std::int64_t t_ns);
/// The same for frames whose poses `pose_of` returns; asks for two poses at most.
template <class PoseOf>
Rigid3d pose_at(std::span<const FramePose> frames, std::int64_t t_ns, const PoseOf& pose_of) {
  const auto end = frames.end();
  auto after = std::ranges::lower_bound(frames, t_ns, {}, &FramePose::t_ns);
  if (after != end && after->t_ns == t_ns) return pose_of(*after);
  if (frames.size() == 1) return pose_of(frames.front());
  after = after == frames.begin() ? after + 1 : after == end ? end - 1 : after;
  const FramePose &b = *after, &a = *(after - 1);
  const double u = static_cast<double>(t_ns - a.t_ns) / static_cast<double>(b.t_ns - a.t_ns);
  return interpolate(pose_of(a), pose_of(b), u);
}

/// Mean velocity of the body's origin in the global frame over 0.2 s around t_ns, in m/s.
Eigen::Vector3d velocity_at(const std::vector<FramePose>& frames, std::int64_t t_ns);

/// Names of a frame's time and pose in a file, for messages.
struct PoseFields {
  std::string time, pose;
};

/// Throws InputError naming file, frame and field unless the times of a drive's frames, sorted by
/// id, increase and none moves from the one before at more than 150 m/s. `frames`: in metres.
void check_trajectory(const std::vector<FramePose>& frames, const std::filesystem::path& file,
                      const PoseFields& fields);
/// The same, but moves single frames that contradict their neighbours to `damaged`, and adds frames
/// from which on the others are elsewhere, which stay.
void leave_out_impossible(const std::filesystem::path& file, const PoseFields& fields,
                          const DamagedList* damaged, std::vector<FramePose>* frames);

/// Moves single poses that are far from the ones around them to `damaged`, for poses milliseconds
/// apart, which need not be frames: times increase, ids do not count. `field`: a pose's name.
void leave_out_strays(const std::filesystem::path& file, const std::string& field,
                      const DamagedList& damaged, std::vector<FramePose>* poses);

}  // namespace redrive
