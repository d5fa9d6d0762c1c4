// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/align.h"

#include <algorithm>
#include <chrono>
#include <cstdio>

#include "redrive/align/bundle/agreeing_tracks.h"
#include "redrive/align/bundle/unobservable_time_offsets.h"
#include "redrive/align/close_loops.h"
#include "redrive/align/windows.h"
#include "redrive/base/error.h"
#include "redrive/base/formatted.h"
#include "redrive/base/progress.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/pose_jumps.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {

Recording with_alignment(Recording recording, const AlignResult& result) {
  recording.frames = result.frames;
  if (!recording.lidars.empty()) recording.lidars[0].elevation_rad = result.lidar_elevation_rad;
  for (std::size_t c = 0; c < recording.cameras.size(); ++c)
    recording.cameras[c].calibration = result.cameras[c];
  return recording;
}

void register_with_ground_truth(const Recording& recording, AlignResult* result) {
  if (recording.ground_truth_frames.empty()) return;
  result->initial_vs_ground_truth =
      register_trajectories(recording.frames, recording.ground_truth_frames, recording.root);
  result->aligned_vs_ground_truth =
      register_trajectories(result->frames, recording.ground_truth_frames, recording.root);
}

namespace {

/// The model with aligned poses and calibrations, for samples of `recording`.
RigModel aligned_model(const Recording& recording, const AlignResult& result) {
  RigModel model = make_rig_model(with_alignment(recording, result));
  model.lidar_elevation_rad = result.lidar_elevation_rad - first_elevation_rad(recording);
  return model;
}

/// Returns the time offsets without which edges of LiDAR depth lie better on the images. Where the
/// car hardly turns, small errors that all images share look like a time offset.
std::vector<UnobservableTimeOffset> offsets_against_edges(const Recording& recording,
                                                          const AlignResult& result,
                                                          const ContrastData& source,
                                                          ThreadPool& pool) {
  constexpr double kMinGain = 0.01;  // differences have a noise of 0.006 over 1000 edges
  RigModel model = aligned_model(recording, result);
  for (std::size_t c = 0; c < model.cameras.size(); ++c)
    model.cameras[c].offset_s = result.camera_corrections[c].initial_offset_s;
  const std::vector<std::optional<EdgeScore>> without = depth_edge_scores(model, source, pool);
  std::vector<UnobservableTimeOffset> rejected;
  for (std::size_t c = 0; c < without.size(); ++c) {
    const CameraCorrection& camera = result.camera_corrections[c];
    if (camera.offset_sigma_s && without[c] && result.aligned_edges[c] &&
        without[c]->score() > result.aligned_edges[c]->score() + kMinGain)
      rejected.push_back({static_cast<int>(c), camera.offset_s, *camera.offset_sigma_s, true});
  }
  return rejected;
}

void print_again(const Recording& recording, const std::vector<UnobservableTimeOffset>& held) {
  std::string names;
  for (const UnobservableTimeOffset& offset : held)
    names += (names.empty() ? "" : ", ") +
             recording.cameras[static_cast<std::size_t>(offset.camera)].calibration.name;
  std::printf(
      "aligning once more with recorded times of %s: with estimated ones its LiDAR edges fit "
      "worse\n",
      names.c_str());
  std::fflush(stdout);
}

}  // namespace

std::vector<LidarSample> load_align_samples(const Recording& recording, const AlignOptions& options,
                                            ThreadPool& pool, std::vector<Finding>* damaged) {
  if (!options.lidar || recording.lidars.empty()) return {};
  const Scene scene = make_scene(recording, {});
  const LidarReturns returns =
      load_lidar_returns(recording, scene, read_moving_objects(recording, scene), pool);
  if (damaged && returns.damaged) damaged->push_back(*returns.damaged);
  return lidar_samples(recording, returns);
}

namespace {

/// States corrections relative to the recorded poses, and names frames whose recorded poses were
/// wrong: frames that needed another correction than their neighbours.
void report_wrong_poses(const Recording& recorded, AlignResult* result) {
  constexpr double kLeast_m = 0.15, kLeast_rad = 1 * kRadiansPerDegree;
  constexpr double kMuchLarger = 8;  // larger than in the median frame
  const int n = static_cast<int>(recorded.frames.size());
  std::vector<double> off_m, off_rad;
  for (int f = 0; f < n; ++f) {
    const Rigid3d change = recorded.frames[f].global_from_body.inverse(Eigen::Isometry) *
                           result->frames[f].global_from_body;
    result->corrections[f].value << change.translation(), so3_log(change.linear());
  }
  for (int f = 0; f < n; ++f) {
    Vector6d off = result->corrections[f].value;
    for (int k = 0; k < 6; ++k) {
      std::vector<double> around;
      for (int i = std::max(0, f - 2); i < std::min(n, f + 3); ++i)
        around.push_back(result->corrections[i].value[k]);
      off[k] -= median_or_zero(&around);
    }
    off_m.push_back(off.head<3>().norm());
    off_rad.push_back(off.tail<3>().norm());
  }
  std::vector<double> sorted_m = off_m, sorted_rad = off_rad;
  const double most_m = std::max(kLeast_m, kMuchLarger * median_or_zero(&sorted_m)),
               most_rad = std::max(kLeast_rad, kMuchLarger * median_or_zero(&sorted_rad));
  const std::vector<int>& unsupported = result->bundle.unsupported_frames;
  for (int f = 0; f < n; ++f) {
    const auto id = static_cast<long long>(recorded.frames[f].id);
    if (std::ranges::binary_search(unsupported, f))
      result->remarks.push_back(
          formatted("frame %lld: most of its image points contradict every pose that was tried; it "
                    "stands between the frames around it, known to %.1f cm",
                    id, 100 * result->corrections[f].sigma.head<3>().norm()));
    else if (off_m[f] > most_m || off_rad[f] > most_rad)
      result->remarks.push_back(formatted(
          "frame %lld: its recorded pose was wrong by %.2f m and %.2f degrees more than those "
          "of the frames around it",
          id, off_m[f], off_rad[f] * kDegreesPerRadian));
  }
}

}  // namespace

AlignResult align(const Recording& recorded, const AlignOptions& options, ThreadPool& pool) {
  if (!recorded.metric)
    throw InsufficientDataError(
        recorded.root, "photographs have neither an egomotion nor times; align is for drives",
        recorded.format);
  Recording recording = recorded;  // begins with poses that may be correct
  recording.frames = without_stray_poses(recorded.frames, find_pose_faults(recorded.frames));
  const bool is_long =
      options.window > 0 && recording.frames.size() > static_cast<std::size_t>(options.window);
  const auto start = std::chrono::steady_clock::now();
  const Progress progress("aligning");
  AlignResult result =
      is_long ? align_in_windows(recording, options, pool) : align_whole(recording, options, pool);
  for (const Finding& damaged : result.damaged)
    result.remarks.push_back(damaged.subject + ": " + damaged.what);
  close_loops(recording, options, pool, &result);
  report_wrong_poses(recorded, &result);
  register_with_ground_truth(recorded, &result);
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

AlignResult align_whole(const Recording& recording, const AlignOptions& options, ThreadPool& pool,
                        std::vector<Track>* kept_tracks) {
  const auto start = std::chrono::steady_clock::now();
  std::optional<RigImages> images;
  std::vector<Track> tracks;
  if (options.images) {
    images = load_track_images(recording, pool, options.tracks);
    tracks = find_tracks(*images, pool, options.tracks);
  }
  std::vector<Finding> damaged;
  if (images) damaged = images->damaged;
  const std::vector<LidarSample> lidar = load_align_samples(recording, options, pool, &damaged);
  std::optional<ContrastData> contrast;
  if (images && !lidar.empty()) contrast.emplace(*images, lidar);
  const std::vector<LidarSample> of_planes = subsample_evenly(lidar, kMaxPlaneSamples);
  const auto align_by = [&](const AlignOptions& by) {
    AlignResult aligned =
        align_with(recording, tracks, of_planes, by, pool, contrast ? &*contrast : nullptr);
    if (contrast)
      aligned.aligned_edges = depth_edge_scores(aligned_model(recording, aligned), *contrast, pool);
    return aligned;
  };
  AlignResult result = align_by(options);
  if (contrast) {
    AlignOptions again = options;
    again.bundle.held_offsets = offsets_against_edges(recording, result, *contrast, pool);
    if (!again.bundle.held_offsets.empty()) {
      if (options.bundle.verbose) print_again(recording, again.bundle.held_offsets);
      result = align_by(again);
    }
    result.initial_edges = depth_edge_scores(make_rig_model(recording), *contrast, pool);
  }
  result.damaged = std::move(damaged);
  if (kept_tracks) *kept_tracks = std::move(tracks);
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace redrive
