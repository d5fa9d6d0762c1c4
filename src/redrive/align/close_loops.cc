// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/close_loops.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>

#include "redrive/align/pose_graph.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/math/voxel_grid.h"

namespace redrive {
namespace {

// distance of knots along the way; distance of candidates
constexpr double kKnot_m = 10, kEach_m = 20;
constexpr double kLeastLoop_m = 60, kLanes_m = 6;  // least way between passes; width of two lanes
constexpr double kMostSearch_m = 12, kMostSearch_rad = 4 * kRadiansPerDegree;
constexpr double kHalfMap_m = 15;     // half the length of way that a map covers
constexpr int kMostRevolutions = 24;  // scans in a map, at most

/// Way driven up to each frame.
std::vector<double> way_of(const std::vector<FramePose>& frames) {
  std::vector<double> way(frames.size());
  for (std::size_t f = 1; f < frames.size(); ++f)
    way[f] = way[f - 1] + (frames[f].global_from_body.translation() -
                           frames[f - 1].global_from_body.translation())
                              .norm();
  return way;
}

/// Returns frames that are kKnot_m apart, the first and the last one among them.
std::vector<int> knots_of(const std::vector<double>& way) {
  std::vector<int> knots{0};
  for (std::size_t f = 1; f < way.size(); ++f)
    if (way[f] - way[knots.back()] >= kKnot_m) knots.push_back(static_cast<int>(f));
  if (const int last = static_cast<int>(way.size()) - 1; knots.back() != last)
    knots.push_back(last);
  return knots;
}

/// Returns the frames around one, kHalfMap_m of the way to both sides.
FrameWindow around(const std::vector<double>& way, int frame) {
  const auto first = std::lower_bound(way.begin(), way.end(), way[frame] - kHalfMap_m),
             last = std::upper_bound(way.begin(), way.end(), way[frame] + kHalfMap_m);
  FrameWindow window{static_cast<int>(first - way.begin()), static_cast<int>(last - way.begin())};
  // A car that stands there has more frames than a map needs.
  constexpr int kMost = 400;
  window.begin = std::max(window.begin, frame - kMost);
  window.end = std::min(window.end, frame + kMost);
  return window;
}

PointMap map_around(const PointsOfFrames& points, const std::vector<FramePose>& frames,
                    const std::vector<double>& way, int frame) {
  const Rigid3d body_from_global = frames[frame].global_from_body.inverse(Eigen::Isometry);
  PointMap map;
  for (const Eigen::Vector3d& p : points(around(way, frame))) {
    const Eigen::Vector3d q = body_from_global * p;
    if (q.head<2>().norm() <= kMapReach_m && std::abs(q.z()) <= kMapReach_m) map.push_back(q);
  }
  return map;
}

/// The returns of a part of the recording, placed by its poses.
std::vector<Eigen::Vector3d> load_points(const Recording& recording, const AlignOptions& options,
                                         const FrameWindow& window, ThreadPool& pool) {
  Recording part = recording;
  part.frames.assign(recording.frames.begin() + window.begin,
                     recording.frames.begin() + window.end);
  std::erase_if(part.lidar_files, [&](const FrameFile& file) {
    return file.frame_id < part.frames.front().id || file.frame_id > part.frames.back().id;
  });
  std::vector<FrameFile> chosen;
  const std::size_t n = part.lidar_files.size(), most = std::min<std::size_t>(n, kMostRevolutions);
  for (std::size_t i = 0; i < most; ++i) chosen.push_back(part.lidar_files[i * n / most]);
  part.lidar_files = std::move(chosen);
  std::vector<Eigen::Vector3d> points;
  if (part.frames.size() < 2 || part.lidar_files.empty()) return points;
  const std::vector<LidarSample> samples = load_align_samples(part, options, pool);
  const RigModel model = make_rig_model(part);
  points.resize(samples.size());
  transform_samples(model, samples, pool, [&](std::size_t i, const Eigen::Vector3d& in_world) {
    points[i] = model.global_from_world * in_world;
  });
  return points;
}

/// Moves all frames with the knots, between two knots in proportion to the way.
void apply(const Recording& recording, const std::vector<double>& way,
           const std::vector<int>& frame_of_knot, const std::vector<Knot>& knots,
           const ClosedTrajectory& closed, const Rigid3d& world_from_global, AlignResult* result) {
  const Rigid3d global_from_world = world_from_global.inverse(Eigen::Isometry);
  std::size_t k = 0;
  for (std::size_t f = 0; f < result->frames.size(); ++f) {
    while (k + 2 < knots.size() && static_cast<int>(f) >= frame_of_knot[k + 1]) ++k;
    const double from_m = way[frame_of_knot[k]], to_m = way[frame_of_knot[k + 1]],
                 u = to_m > from_m ? (way[f] - from_m) / (to_m - from_m) : 0;
    const auto change = [&](std::size_t knot) -> Rigid3d {
      return knots[knot].world_from_body.inverse(Eigen::Isometry) * closed.poses[knot];
    };
    // The changes of both knots, in the axes of the body, applied to this frame.
    const Rigid3d pose = world_from_global * result->frames[f].global_from_body;
    const auto carried = [&](std::size_t knot) -> Rigid3d {
      const Rigid3d from_knot = knots[knot].world_from_body.inverse(Eigen::Isometry) * pose;
      return knots[knot].world_from_body * change(knot) * from_knot;
    };
    result->frames[f].global_from_body =
        global_from_world * interpolate(carried(k), carried(k + 1), u);
    Correction& correction = result->corrections[f];
    const Rigid3d whole = recording.frames[f].global_from_body.inverse(Eigen::Isometry) *
                          result->frames[f].global_from_body;
    correction.value << whole.translation(), so3_log(whole.linear());
    const Vector6d variance =
        closed.variance[k] + u * (closed.variance[k + 1] - closed.variance[k]);
    correction.sigma = (correction.sigma.cwiseAbs2() + variance).cwiseSqrt();
  }
}

}  // namespace

double loop_search_m(double way_m) { return std::min(3 * drift_m(way_m), kMostSearch_m); }

std::vector<LoopCandidate> find_loop_candidates(const std::vector<FramePose>& frames) {
  if (frames.empty()) return {};
  constexpr double kReach_m = kLanes_m + kMostSearch_m;  // side of a cell of the grid
  const std::vector<double> way = way_of(frames);
  const std::vector<int> knots = knots_of(way);
  std::map<std::uint64_t, std::vector<int>> grid;  // frames at knots
  std::vector<LoopCandidate> found;
  double next_m = 0;
  for (const int knot : knots) {
    const Eigen::Vector3d at = frames[knot].global_from_body.translation();
    const Voxel cell = voxel_of(at, kReach_m);
    std::optional<LoopCandidate> nearest;
    if (way[knot] >= next_m)
      for (long x = -1; x <= 1; ++x)
        for (long y = -1; y <= 1; ++y)
          for (long z = -1; z <= 1; ++z) {
            const auto there = grid.find(voxel_key(cell + Voxel(x, y, z)));
            if (there == grid.end()) continue;
            for (const int other : there->second) {
              const double driven_m = way[knot] - way[other],
                           distance_m = (frames[other].global_from_body.translation() - at).norm();
              if (driven_m < kLeastLoop_m || distance_m > kLanes_m + loop_search_m(driven_m))
                continue;
              if (!nearest || distance_m < nearest->distance_m)
                nearest = LoopCandidate{other, knot, driven_m, distance_m};
            }
          }
    if (nearest) {
      found.push_back(*nearest);
      next_m = way[knot] + kEach_m;
    }
    grid[voxel_key(cell)].push_back(knot);
  }
  return found;
}

LoopClosures close_loops(const Recording& recording, const PointsOfFrames& points,
                         AlignResult* result) {
  LoopClosures report;
  const std::vector<LoopCandidate> candidates = find_loop_candidates(result->frames);
  report.candidates = static_cast<int>(std::ssize(candidates));
  if (candidates.empty()) return report;
  const std::vector<FramePose>& frames = result->frames;
  const std::vector<double> way = way_of(frames);
  const std::vector<int> frame_of_knot = knots_of(way);
  const Rigid3d world_from_global = frames.front().global_from_body.inverse(Eigen::Isometry);
  std::vector<Knot> knots;
  std::map<int, int> knot_of_frame;
  for (const int frame : frame_of_knot) {
    knot_of_frame[frame] = static_cast<int>(std::ssize(knots));
    knots.push_back({world_from_global * frames[frame].global_from_body, way[frame],
                     result->corrections[frame].sigma.cwiseAbs2()});
  }
  std::vector<LoopClosure> closures;
  for (const LoopCandidate& candidate : candidates) {
    const PointMap of_from = map_around(points, frames, way, candidate.from),
                   of_to = map_around(points, frames, way, candidate.to);
    const Rigid3d guess = frames[candidate.from].global_from_body.inverse(Eigen::Isometry) *
                          frames[candidate.to].global_from_body;
    const double turn_rad = std::min(3 * kDrift_rad * std::sqrt(candidate.way_m), kMostSearch_rad);
    const MapRegistration found =
        register_maps(of_from, of_to, guess, loop_search_m(candidate.way_m), turn_rad);
    if (!found.doubt.empty()) {
      report.doubts.push_back(found.doubt);
      continue;
    }
    closures.push_back({knot_of_frame.at(candidate.from), knot_of_frame.at(candidate.to),
                        found.target_from_source, found.covariance});
  }
  report.registered = static_cast<int>(std::ssize(closures));
  const ClosedTrajectory closed = close_trajectory(knots, closures);
  report.accepted = static_cast<int>(std::ranges::count(closed.accepted, true));
  report.before_m = closed.before_m, report.before_rad = closed.before_rad;
  report.after_m = closed.after_m, report.after_rad = closed.after_rad;
  if (report.accepted > 0)
    apply(recording, way, frame_of_knot, knots, closed, world_from_global, result);
  return report;
}

void close_loops(const Recording& recording, const AlignOptions& options, ThreadPool& pool,
                 AlignResult* result) {
  const bool lidar = options.lidar && !recording.lidars.empty() && !recording.lidar_files.empty();
  if (!lidar) {
    if (const auto found = find_loop_candidates(result->frames); !found.empty())
      result->remarks.push_back(
          "the drive meets itself at " + std::to_string(found.size()) +
          " places; without LiDAR, which tells where, they tie nothing together");
    return;
  }
  const Recording placed = with_alignment(recording, *result);
  const LoopClosures report = close_loops(
      recording,
      [&](const FrameWindow& window) { return load_points(placed, options, window, pool); },
      result);
  if (report.candidates == 0) return;
  char text[300];
  std::snprintf(text, sizeof text,
                "loop closures: %d of %d candidates accepted (%d rejected by their LiDAR, %d by "
                "the other closures or the largest drift)",
                report.accepted, report.candidates, report.candidates - report.registered,
                report.registered - report.accepted);
  std::string remark = text;
  if (report.accepted > 0) {
    std::snprintf(text, sizeof text,
                  "; passes of a place lay %.1f cm and %.3f degrees apart, now %.1f cm and %.3f "
                  "degrees RMS",
                  100 * report.before_m, report.before_rad * kDegreesPerRadian,
                  100 * report.after_m, report.after_rad * kDegreesPerRadian);
    remark += text;
  }
  result->remarks.push_back(std::move(remark));
}

}  // namespace redrive
