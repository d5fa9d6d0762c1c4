// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/summary.h"

#include <algorithm>
#include <cstdio>

#include "redrive/recording/core/pose_jumps.h"

namespace redrive {

DriveSummary summarize_drive(const std::vector<FramePose>& frames) {
  DriveSummary summary;
  if (frames.size() < 2) {
    summary.findings.push_back(
        {"egomotion",
         "a single pose: the car does not move, so depth cannot be seen from one camera"});
    return summary;
  }
  std::vector<double> intervals_s;
  for (std::size_t i = 1; i < frames.size(); ++i) {
    const double interval_s = static_cast<double>(frames[i].t_ns - frames[i - 1].t_ns) * 1e-9;
    const double step_m =
        (frames[i].global_from_body.translation() - frames[i - 1].global_from_body.translation())
            .norm();
    intervals_s.push_back(interval_s);
    summary.path_length_m += step_m;
    summary.max_speed_m_per_s = std::max(summary.max_speed_m_per_s, step_m / interval_s);
  }
  summary.duration_s = static_cast<double>(frames.back().t_ns - frames.front().t_ns) * 1e-9;
  summary.mean_speed_m_per_s = summary.path_length_m / summary.duration_s;
  std::vector<double> sorted = intervals_s;
  std::sort(sorted.begin(), sorted.end());
  const double median_s = (sorted[(sorted.size() - 1) / 2] + sorted[sorted.size() / 2]) / 2;
  summary.rate_hz = 1 / median_s;

  constexpr std::size_t kShown = 5;
  std::size_t gaps = 0;
  for (std::size_t i = 1; i < frames.size(); ++i) {
    // At least half an interval is missing; less is normal jitter.
    if (intervals_s[i - 1] <= 1.5 * median_s) continue;
    if (++gaps > kShown) continue;
    char what[160];
    std::snprintf(what, sizeof what,
                  "a gap of %.3f s between frames %lld and %lld, where %.3f s is usual",
                  intervals_s[i - 1], static_cast<long long>(frames[i - 1].id),
                  static_cast<long long>(frames[i].id), median_s);
    summary.findings.push_back({"egomotion", what});
  }
  if (gaps > kShown)
    summary.findings.push_back({"egomotion", std::to_string(gaps - kShown) + " more gaps"});
  const std::vector<Finding> faults = describe_pose_faults(frames, find_pose_faults(frames));
  summary.findings.insert(summary.findings.end(), faults.begin(), faults.end());
  return summary;
}

}  // namespace redrive
