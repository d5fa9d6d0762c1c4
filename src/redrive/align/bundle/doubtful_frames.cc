// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/doubtful_frames.h"

#include <algorithm>
#include <limits>

#include "redrive/math/so3.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {
namespace {

constexpr int kLeastObserved = 20;

bool contains(const std::vector<int>& frames, int frame) {
  return std::ranges::binary_search(frames, frame);
}

std::vector<FramePose> poses_without(const std::vector<FramePose>& all,
                                     const std::vector<int>& frames) {
  std::vector<FramePose> others;
  for (int f = 0; f < static_cast<int>(all.size()); ++f)
    if (!contains(frames, f)) others.push_back(all[f]);
  return others;
}

/// The motion from a to b, in the axes of a.
Vector6d motion_between(const Rigid3d& a, const Rigid3d& b) {
  const Rigid3d step = a.inverse(Eigen::Isometry) * b;
  Vector6d motion;
  motion << step.translation(), so3_log(step.linear());
  return motion;
}

}  // namespace

std::vector<int> doubtful_frames(const std::vector<FrameSupport>& support, double share) {
  const auto share_of = [](const FrameSupport& frame) {
    return static_cast<double>(frame.used) / frame.observed;
  };
  std::vector<double> shares;
  for (const FrameSupport& frame : support)
    if (frame.observed >= kLeastObserved) shares.push_back(share_of(frame));
  if (shares.empty()) return {};
  const auto middle = shares.begin() + static_cast<std::ptrdiff_t>(shares.size() / 2);
  std::ranges::nth_element(shares, middle);
  const double least = std::min(share, *middle / 2);
  std::vector<int> doubtful;
  for (std::size_t f = 0; f < support.size(); ++f)
    if (support[f].observed >= kLeastObserved && share_of(support[f]) < least)
      doubtful.push_back(static_cast<int>(f));
  return doubtful;
}

void place_between_neighbours(const std::vector<int>& frames, RigModel* model) {
  const std::vector<FramePose> corrected = model->corrected_frames();
  RigModel uncorrected = *model;
  for (Vector6d& correction : uncorrected.corrections) correction.setZero();
  const std::vector<FramePose> others = poses_without(corrected, frames),
                               initial = poses_without(uncorrected.corrected_frames(), frames);
  if (others.empty()) return;
  const Rigid3d world_from_global = model->global_from_world.inverse(Eigen::Isometry);
  for (const int f : frames) {
    const std::int64_t t_ns = corrected[f].t_ns;
    Rigid3d& pose = model->initial_frames[f].world_from_body;
    pose = world_from_global * pose_at(initial, t_ns);
    model->corrections[f] = motion_between(pose, world_from_global * pose_at(others, t_ns));
  }
}

Vector6d interpolation_sigma(const RigModel& model, const std::vector<int>& listed, int frame) {
  const std::vector<FramePose> all = model.corrected_frames();
  const int n = static_cast<int>(all.size());
  int before = 1, after = 1;  // distance in frames to the nearest frames that are not listed
  while (contains(listed, frame - before)) ++before;
  while (contains(listed, frame + after)) ++after;
  // At an end the two nearest frames on the other side are extrapolated.
  int a = -before, b = after;
  if (frame + a < 0)
    a = b, ++b;
  else if (frame + b >= n)
    b = a, --a;
  Vector6d squares = Vector6d::Zero();
  int count = 0;
  for (int f = std::max({0, -a, -b}); f < n - std::max({0, a, b}); ++f) {
    if (contains(listed, f) || contains(listed, f + a) || contains(listed, f + b)) continue;
    const std::vector<FramePose> pair{all[f + std::min(a, b)], all[f + std::max(a, b)]};
    squares += motion_between(pose_at(pair, all[f].t_ns), all[f].global_from_body).cwiseAbs2();
    ++count;
  }
  if (count == 0) return Vector6d::Constant(std::numeric_limits<double>::infinity());
  return (squares / count).cwiseSqrt();
}

}  // namespace redrive
