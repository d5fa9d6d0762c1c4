// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/trajectory.h"

#include <algorithm>
#include <cstdio>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr double kMaxSpeed_m_per_s = 150;
constexpr std::int64_t kVelocityOver_ns =
    100'000'000;  // to either side, to average errors of single poses

void check_step(const FramePose& a, const FramePose& b, const std::filesystem::path& file,
                const PoseFields& fields) {
  const std::string id = std::to_string(b.id), before = std::to_string(a.id);
  const double dt_s = static_cast<double>(b.t_ns - a.t_ns) * 1e-9;
  if (b.t_ns <= a.t_ns) {
    char value[64];
    std::snprintf(value, sizeof value, "%.9f s", static_cast<double>(b.t_ns) * 1e-9);
    throw InputError(
        file, id + "." + fields.time, value,
        "times have to increase with the frame id, but this is not after frame " + before);
  }
  const double step_m =
      (b.global_from_body.translation() - a.global_from_body.translation()).norm();
  if (step_m > kMaxSpeed_m_per_s * dt_s) {
    char value[96];
    std::snprintf(value, sizeof value, "%.2f m away from frame %s, %.3f s later", step_m,
                  before.c_str(), dt_s);
    throw InputError(file, id + "." + fields.pose, value,
                     "no car moves so: at most 150 m/s are accepted");
  }
}

}  // namespace

Rigid3d pose_at(const std::vector<FramePose>& frames, std::int64_t t_ns) {
  REDRIVE_CHECK(!frames.empty());
  return pose_at(frames, t_ns, [](const FramePose& frame) { return frame.global_from_body; });
}

Eigen::Vector3d velocity_at(const std::vector<FramePose>& frames, std::int64_t t_ns) {
  return (pose_at(frames, t_ns + kVelocityOver_ns).translation() -
          pose_at(frames, t_ns - kVelocityOver_ns).translation()) /
         (2e-9 * static_cast<double>(kVelocityOver_ns));
}

void check_trajectory(const std::vector<FramePose>& frames, const std::filesystem::path& file,
                      const PoseFields& fields) {
  for (std::size_t i = 1; i < frames.size(); ++i)
    check_step(frames[i - 1], frames[i], file, fields);
}

void leave_out_impossible(const std::filesystem::path& file, const PoseFields& fields,
                          const DamagedList* damaged, std::vector<FramePose>* frames) {
  if (!damaged) return check_trajectory(*frames, file, fields);
  const auto why_not = [&](std::size_t a, std::size_t b) -> std::string {
    try {
      check_step((*frames)[a], (*frames)[b], file, fields);
      return "";
    } catch (const InputError& error) {
      return error.what();
    }
  };
  const Misfits misfits = find_misfits(
      frames->size(), [&](std::size_t a, std::size_t b) { return why_not(a, b).empty(); });
  const auto is_single = [&](std::size_t i) {
    return std::ranges::binary_search(misfits.single, i);
  };
  std::vector<std::int64_t> left_out;
  for (const std::size_t i : misfits.single) {
    std::size_t before = i, after = i;
    while (before > 0 && is_single(before)) --before;
    while (after + 1 < frames->size() && is_single(after)) ++after;
    std::string why = is_single(before) ? "" : why_not(before, i);
    if (why.empty() && !is_single(after)) why = why_not(i, after);
    left_out.push_back((*frames)[i].id);
    damaged->records->push_back({damaged->sensor, left_out.back(),
                                 why.empty() ? InputError(file, std::to_string(left_out.back()), "",
                                                          "contradicts the frames around it")
                                                   .what()
                                             : why});
  }
  for (const std::size_t i : misfits.breaks)
    damaged->records->push_back({damaged->sensor, (*frames)[i].id, why_not(i - 1, i), true});
  std::erase_if(*frames, [&](const FramePose& frame) {
    return std::ranges::binary_search(left_out, frame.id);
  });
}

void leave_out_strays(const std::filesystem::path& file, const std::string& field,
                      const DamagedList& damaged, std::vector<FramePose>* poses) {
  constexpr double kMost_m = 1, kMost_m_per_s = 150;
  const Misfits misfits = find_misfits(poses->size(), [&](std::size_t a, std::size_t b) {
    const FramePose &before = (*poses)[a], &after = (*poses)[b];
    const double dt_s = 1e-9 * static_cast<double>(after.t_ns - before.t_ns);
    return (after.global_from_body.translation() - before.global_from_body.translation()).norm() <=
           kMost_m + kMost_m_per_s * dt_s;
  });
  for (const std::size_t i : misfits.single)
    damaged.records->push_back(
        {damaged.sensor, -1,
         InputError(file, field + " at " + std::to_string((*poses)[i].t_ns) + " ns", "",
                    "no car moves so to the poses around it")
             .what()});
  for (auto i = misfits.single.rbegin(); i != misfits.single.rend(); ++i)
    poses->erase(poses->begin() + static_cast<std::ptrdiff_t>(*i));
}

}  // namespace redrive
