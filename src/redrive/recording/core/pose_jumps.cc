// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/pose_jumps.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {
namespace {

constexpr double kMaxAcceleration_m_per_s2 = 20, kMaxAcceleration_rad_per_s2 = 5;
constexpr double kLeastShift_m = 0.25, kLeastTurn_rad = 2 * kRadiansPerDegree;
constexpr double kNoises = 8;          // standard deviations
constexpr std::size_t kWindow = 5;     // intervals on each side
constexpr std::size_t kLeastSide = 3;  // intervals with a median
constexpr std::size_t kMostStray = 4;  // frames in a row
constexpr std::size_t kLeastFrames = 5;

double interval_s(const std::vector<FramePose>& frames, std::size_t i) {
  return 1e-9 * static_cast<double>(frames[i + 1].t_ns - frames[i].t_ns);
}

/// Velocities between frames: m/s in the global frame, rad/s in the body's.
std::vector<Vector6d> velocities(const std::vector<FramePose>& frames) {
  std::vector<Vector6d> all;
  for (std::size_t i = 0; i + 1 < frames.size(); ++i) {
    const Rigid3d &a = frames[i].global_from_body, &b = frames[i + 1].global_from_body;
    Vector6d step;
    step << b.translation() - a.translation(), so3_log(a.linear().transpose() * b.linear());
    all.push_back(step / interval_s(frames, i));
  }
  return all;
}

Vector6d median_of(const std::vector<Vector6d>& values, std::size_t begin, std::size_t end,
                   std::size_t without) {
  Vector6d medians;
  for (int k = 0; k < 6; ++k) {
    std::vector<double> of_axis;
    for (std::size_t i = begin; i < end; ++i)
      if (i != without) of_axis.push_back(values[i][k]);
    medians[k] = upper_median(std::move(of_axis));
  }
  return medians;
}

/// Returns the velocity at interval i that its neighbours suggest.
Vector6d expected_velocity(const std::vector<Vector6d>& v, std::size_t i) {
  const std::size_t begin = i - std::min(i, kWindow), end = std::min(i + 1 + kWindow, v.size());
  const bool before = i - begin >= kLeastSide, after = end - i - 1 >= kLeastSide;
  if (before && after) return (median_of(v, begin, i, i) + median_of(v, i + 1, end, i)) / 2;
  if (before) return median_of(v, begin, i, i);
  if (after) return median_of(v, i + 1, end, i);
  return median_of(v, begin, end, i);
}

/// Returns the intervals with a jump, in order.
std::vector<PoseJump> all_jumps(const std::vector<FramePose>& frames) {
  const std::vector<Vector6d> v = velocities(frames);
  std::vector<PoseJump> steps;
  std::vector<double> shifts_m, turns_rad;
  for (std::size_t i = 0; i < v.size(); ++i) {
    const Vector6d off = (v[i] - expected_velocity(v, i)) * interval_s(frames, i);
    steps.push_back({i, off.head<3>().norm(), off.tail<3>().norm()});
    shifts_m.push_back(steps.back().shift_m);
    turns_rad.push_back(steps.back().turn_rad);
  }
  constexpr double kNormal = 1.5382;  // median of the length of a standard normal vector in 3D
  const double noise_m = upper_median(shifts_m) / kNormal,
               noise_rad = upper_median(turns_rad) / kNormal;
  std::erase_if(steps, [&](const PoseJump& step) {
    const double dt2 = std::pow(interval_s(frames, step.frame), 2);
    return step.shift_m <=
               std::max({kLeastShift_m, kMaxAcceleration_m_per_s2 * dt2, kNoises * noise_m}) &&
           step.turn_rad <=
               std::max({kLeastTurn_rad, kMaxAcceleration_rad_per_s2 * dt2, kNoises * noise_rad});
  });
  return steps;
}

/// Measures how far stray poses lie off the path of the others.
void measure_stray(const std::vector<FramePose>& frames, PoseFaults* faults) {
  const std::vector<FramePose> mended = without_stray_poses(frames, *faults);
  for (StrayPose& stray : faults->stray) {
    const Rigid3d off = mended[stray.frame].global_from_body.inverse(Eigen::Isometry) *
                        frames[stray.frame].global_from_body;
    stray.off_m = off.translation().norm();
    stray.off_rad = so3_log(off.linear()).norm();
  }
}

}  // namespace

PoseFaults find_pose_faults(const std::vector<FramePose>& frames) {
  PoseFaults faults;
  if (frames.size() < kLeastFrames) return faults;
  const std::vector<PoseJump> jumps = all_jumps(frames);
  if (jumps.empty()) return faults;
  // Parts between jumps, [begin, end): short ones are stray.
  std::size_t begin = 0;
  for (std::size_t k = 0; k <= jumps.size(); ++k) {
    const std::size_t end = k < jumps.size() ? jumps[k].frame + 1 : frames.size();
    if (end - begin <= kMostStray)
      for (std::size_t f = begin; f < end; ++f) faults.stray.push_back({f});
    begin = end;
  }
  if (4 * faults.stray.size() > frames.size()) return {jumps, {}};
  measure_stray(frames, &faults);
  // Good poses between two stray ones, or between one and an end, lie on the others' path.
  std::erase_if(faults.stray, [](const StrayPose& stray) {
    return stray.off_m <= kLeastShift_m && stray.off_rad <= kLeastTurn_rad;
  });
  measure_stray(frames, &faults);
  faults.jumps = all_jumps(without_stray_poses(frames, faults));
  return faults;
}

std::vector<FramePose> without_stray_poses(std::vector<FramePose> frames,
                                           const PoseFaults& faults) {
  std::vector<FramePose> good;
  std::size_t k = 0;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    if (k < faults.stray.size() && faults.stray[k].frame == f)
      ++k;
    else
      good.push_back(frames[f]);
  }
  for (const StrayPose& stray : faults.stray)
    frames[stray.frame].global_from_body = pose_at(good, frames[stray.frame].t_ns);
  return frames;
}

std::vector<Finding> describe_pose_faults(const std::vector<FramePose>& frames,
                                          const PoseFaults& faults) {
  constexpr std::size_t kShown = 5;
  std::vector<Finding> findings;
  char what[200];
  const auto add = [&](std::size_t k) {
    if (k < kShown) findings.push_back({"egomotion", what});
  };
  for (std::size_t k = 0; k < faults.stray.size(); ++k) {
    const StrayPose& stray = faults.stray[k];
    std::snprintf(
        what, sizeof what,
        "the pose of frame %lld lies %.2f m and %.1f degrees off the motion of the frames "
        "around it; redrive align mends it",
        static_cast<long long>(frames[stray.frame].id), stray.off_m,
        stray.off_rad * kDegreesPerRadian);
    add(k);
  }
  for (std::size_t k = 0; k < faults.jumps.size(); ++k) {
    const PoseJump& jump = faults.jumps[k];
    std::snprintf(what, sizeof what,
                  "between frames %lld and %lld the poses jump by %.2f m and %.1f degrees beyond "
                  "the motion before and after; redrive align may mend it",
                  static_cast<long long>(frames[jump.frame].id),
                  static_cast<long long>(frames[jump.frame + 1].id), jump.shift_m,
                  jump.turn_rad * kDegreesPerRadian);
    add(k);
  }
  const auto more = [&](std::size_t n, const char* of) {
    if (n > kShown) findings.push_back({"egomotion", std::to_string(n - kShown) + " more " + of});
  };
  more(faults.stray.size(), "poses off the motion of the frames around them");
  more(faults.jumps.size(), "jumps");
  return findings;
}

}  // namespace redrive
