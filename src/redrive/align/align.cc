// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/align.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <limits>
#include <numbers>

#include <Eigen/Dense>

#include "redrive/align/bundle/unobservable_time_offsets.h"
#include "redrive/base/error.h"
#include "redrive/math/so3.h"
#include "redrive/recording/summary.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;

// What a usable result is. A pose less certain than this would make pictures worse, not better.
constexpr double kMostSigma_m = 0.08, kMostSigma_rad = 0.2 / kDegrees;
constexpr double kMostMoving_m = 0.015, kMostMoving_rad = 0.04 / kDegrees;  // by the last round
constexpr double kLeastUsed = 0.4;     // share of the observations that agree
constexpr double kMostNoise_px = 2.5;  // of a camera's observations
constexpr double kMostPose_m = 5, kMostPose_rad = 6 / kDegrees;      // no egomotion is off by more
constexpr double kMostMount_m = 0.3, kMostMount_rad = 3 / kDegrees;  // no camera is
constexpr double kMostOffset_s = 0.1;          // that would be another frame's image
constexpr double kMostReadoutSigma_s = 0.004;  // rows usually take 15 to 35 ms
constexpr double kLeastReach_m = 1;
constexpr std::size_t kMostPlaneSamples = 800'000;
constexpr int kLeastTracks = 30, kLeastLidarPoints = 1000;

std::string text(const char* format, ...) __attribute__((format(printf, 1, 2)));
std::string text(const char* format, ...) {
  char buffer[400];
  va_list values;
  va_start(values, format);
  std::vsnprintf(buffer, sizeof buffer, format, values);
  va_end(values);
  return buffer;
}

/// What was there to align by, for every message.
std::string means_of(const Recording& recording, std::size_t tracks, std::size_t lidar) {
  const double path_length_m =
      recording.frames.empty() ? 0 : summarize_drive(recording.frames).path_length_m;
  return text("%zu frames, %.1f m driven, %zu tracks of image points, %zu LiDAR points",
              recording.frames.size(), path_length_m, tracks, lidar);
}

/// Takes the part of the covariance out that is a motion of the whole trajectory: P C P^T with P =
/// 1 - G (G^T W G)^-1 G^T W, G what such a motion does to the corrections. W weighs a turn as what
/// it moves at 30 m, as register_trajectories does. Where only the egomotion knows the scale, that
/// is taken out, too.
Eigen::MatrixXd without_common_motion(const RigModel& model, const Eigen::MatrixXd& covariance,
                                      bool scale_too) {
  constexpr double kArm_m = 30;
  const int n = static_cast<int>(model.given.size());
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const FramePose& frame : model.given) middle += frame.global_from_body.translation() / n;
  Eigen::MatrixXd g(6 * n, scale_too ? 7 : 6);
  Eigen::VectorXd weights(6 * n);
  for (int f = 0; f < n; ++f) {
    const Eigen::Matrix3d body_from_world = model.given[f].global_from_body.linear().transpose();
    g.block<3, 3>(6 * f, 0) = body_from_world;
    g.block<3, 3>(6 * f, 3) =
        -body_from_world * skew(model.given[f].global_from_body.translation() - middle);
    g.block<3, 3>(6 * f + 3, 0).setZero();
    g.block<3, 3>(6 * f + 3, 3) = body_from_world;
    if (scale_too) {
      g.block<3, 1>(6 * f, 6) =
          body_from_world * (model.given[f].global_from_body.translation() - middle);
      g.block<3, 1>(6 * f + 3, 6).setZero();
    }
    weights.segment<3>(6 * f).setOnes();
    weights.segment<3>(6 * f + 3).setConstant(kArm_m * kArm_m);
  }
  const Eigen::MatrixXd weighted = g.transpose() * weights.asDiagonal();
  const Eigen::MatrixXd solved = (weighted * g).ldlt().solve(weighted);  // [6 or 7, 6 n]
  const Eigen::MatrixXd half = covariance - g * (solved * covariance);
  return half - (half * solved.transpose()) * g.transpose();
}

Vector6d sigmas_at(const Eigen::VectorXd& variance, int at) {
  return variance.segment<6>(at).cwiseMax(0).cwiseSqrt();
}

/// Of one number, where it was sought.
std::optional<double> sigma_at(const BundleResult& bundle, const std::optional<int>& at) {
  if (!at) return std::nullopt;
  return std::sqrt(std::max(0.0, bundle.variance[*at]));
}

/// A readout as it was found before others were given up.
struct ReadoutEstimate {
  double value_s = 0, sigma_s = 0;
};

/// Puts readouts back as they were given that the drive does not tell, or not without what others
/// were given up for, and takes them from what is sought: a line about each. *before: of the last
/// time, by camera; empty the first time.
std::vector<std::string> fix_unobservable_readouts(const BundleResult& bundle,
                                                   std::vector<ReadoutEstimate>* before,
                                                   RigModel* model, BundleOptions* options) {
  double interval_s = std::numeric_limits<double>::infinity();
  for (std::size_t f = 1; f < model->given.size(); ++f)
    interval_s = std::min(
        interval_s, 1e-9 * static_cast<double>(model->given[f].t_ns - model->given[f - 1].t_ns));
  const double most_s = std::min(kMaxReadout_s, interval_s);
  std::vector<std::string> remarks;
  std::vector<ReadoutEstimate> found(model->cameras.size());
  for (std::size_t c = 0; c < found.size(); ++c) {
    const std::optional<double> sigma_s = sigma_at(bundle, bundle.readout_index[c]);
    if (!sigma_s) continue;
    RigModelCamera& camera = model->cameras[c];
    const ReadoutEstimate now{camera.readout_s, *sigma_s};
    found[c] = now;
    std::string why;
    if (now.sigma_s > kMostReadoutSigma_s)
      why = text("known to %.1f ms, 1 sigma; %.0f are needed", 1e3 * now.sigma_s,
                 1e3 * kMostReadoutSigma_s);
    else if (std::abs(now.value_s) > most_s)
      why = text("%.0f ms fit best, and no more than %.0f can be", 1e3 * now.value_s, 1e3 * most_s);
    else if (!before->empty() &&
             std::abs(now.value_s - (*before)[c].value_s) > 3 * (*before)[c].sigma_s)
      why = text("%.1f ms with other readouts open, %.1f with those as given",
                 1e3 * (*before)[c].value_s, 1e3 * now.value_s);
    if (why.empty()) continue;
    camera.readout_s = camera.initial_readout_s();
    options->readouts[c] = false;
    remarks.push_back(
        text("%s: the drive does not tell how long its rows take (%s): %.2f ms stay, as given",
             camera.given.name.c_str(), why.c_str(), 1e3 * camera.readout_s));
  }
  *before = std::move(found);
  return remarks;
}

std::string unobservable_text(const CameraCorrection& camera, const UnobservableTimeOffset& clock,
                              const BundlePriors& priors) {
  return text(
      "%s: cannot tell when it exposes (%+.1f +- %.1f ms fits best, and +- %.1f is needed: "
      "straight on at one speed a "
      "late exposure looks like a camera further forward): %.2f ms stay, as given",
      camera.name.c_str(), 1e3 * clock.offset_s, 1e3 * clock.sigma_s,
      1e3 * max_observable_sigma_s(priors.offset_s), 1e3 * camera.offset_s);
}

AlignResult describe(const RigModel& model, BundleResult bundle, bool scale_is_given) {
  AlignResult result;
  const int n = static_cast<int>(model.given.size()),
            cameras = static_cast<int>(model.cameras.size());
  result.frames = model.corrected_frames();
  const Eigen::MatrixXd shape =
      without_common_motion(model, bundle.covariance.topLeftCorner(6 * n, 6 * n), scale_is_given);
  for (int f = 0; f < n; ++f)
    result.corrections.push_back({model.correction[f], sigmas_at(shape.diagonal(), 6 * f)});
  for (int c = 0; c < cameras; ++c) {
    const RigModelCamera& camera = model.cameras[c];
    result.cameras.push_back(model.corrected_calibration(c));
    CameraCorrection correction;
    correction.name = camera.given.name;
    correction.mount = {camera.mount, sigmas_at(bundle.variance, 6 * (n + c))};
    correction.rotation_in_body = camera.given.body_from_sensor.linear() * camera.mount.tail<3>();
    correction.offset_s = camera.offset_s;
    correction.initial_offset_s = camera.initial_offset_s();
    correction.offset_sigma_s = sigma_at(bundle, bundle.offset_index[c]);
    correction.readout_s = camera.readout_s;
    correction.initial_readout_s = camera.initial_readout_s();
    correction.readout_sigma_s = sigma_at(bundle, bundle.readout_index[c]);
    correction.intrinsics = camera.intrinsics;
    result.camera_corrections.push_back(correction);
  }
  result.bundle = std::move(bundle);
  return result;
}

/// How far the trajectory leads from its first frame, at most.
double reach_m(const std::vector<FramePose>& frames) {
  double reach = 0;
  for (const FramePose& frame : frames)
    reach = std::max(reach, (frame.global_from_body.translation() -
                             frames.front().global_from_body.translation())
                                .norm());
  return reach;
}

/// Why the result cannot be used, or empty.
std::string obstacle(const Recording& recording, const AlignResult& result, bool images) {
  const BundleResult& bundle = result.bundle;
  if (bundle.lidar_points == 0 &&
      !(std::min(reach_m(recording.frames), reach_m(result.frames)) >= kLeastReach_m))
    return text(
        "the car stands still (%.2f m from its first pose at most, %.2f m once aligned), and "
        "without LiDAR only "
        "driving shows how far "
        "things are; %.0f m are needed",
        reach_m(recording.frames), reach_m(result.frames), kLeastReach_m);
  if (!(bundle.last_translation_m < kMostMoving_m && bundle.last_rotation_rad < kMostMoving_rad))
    return text(
        "the poses still move by %.1f cm and %.3f degrees a round after %d rounds: what is seen "
        "does not agree with "
        "one "
        "motion",
        100 * bundle.last_translation_m, bundle.last_rotation_rad * kDegrees, bundle.rounds);
  int all = 0, used = 0;
  for (std::size_t c = 0; c < bundle.cameras.size(); ++c) {
    const CameraFit& fit = bundle.cameras[c];
    all += fit.observations;
    used += fit.used;
    if (fit.used > 0 && fit.sigma_px > kMostNoise_px)
      return text(
          "image points of %s are %.1f px off from where the aligned poses put them; %.1f are "
          "accepted",
          result.cameras[c].name.c_str(), fit.sigma_px, kMostNoise_px);
  }
  if (images && all > 0 && used < kLeastUsed * all)
    return text("only %.0f %% of the image points agree with one motion; %.0f %% are needed",
                100.0 * used / all, 100 * kLeastUsed);
  double worst_m = 0, worst_rad = 0;
  std::size_t at_m = 0, at_rad = 0;
  for (std::size_t f = 0; f < result.corrections.size(); ++f) {
    const Correction& c = result.corrections[f];
    if (c.sigma.head<3>().norm() > worst_m) worst_m = c.sigma.head<3>().norm(), at_m = f;
    if (c.sigma.tail<3>().norm() > worst_rad) worst_rad = c.sigma.tail<3>().norm(), at_rad = f;
    if (!(c.value.head<3>().norm() < kMostPose_m && c.value.tail<3>().norm() < kMostPose_rad))
      return text(
          "frame %lld would have to move by %.2f m and %.2f degrees; an egomotion that is off by "
          "more than %.0f m or "
          "%.0f "
          "degrees is no start",
          static_cast<long long>(result.frames[f].id), c.value.head<3>().norm(),
          c.value.tail<3>().norm() * kDegrees, kMostPose_m, kMostPose_rad * kDegrees);
  }
  if (!(worst_m <= kMostSigma_m))
    return text(
        "nothing holds the position of frame %lld: known to %.1f cm (1 sigma) after the alignment, "
        "%.0f cm are needed",
        static_cast<long long>(recording.frames[at_m].id), 100 * worst_m, 100 * kMostSigma_m);
  if (!(worst_rad <= kMostSigma_rad))
    return text(
        "nothing holds the rotation of frame %lld: known to %.2f degrees (1 sigma) after the "
        "alignment, %.2f are "
        "needed",
        static_cast<long long>(recording.frames[at_rad].id), worst_rad * kDegrees,
        kMostSigma_rad * kDegrees);
  for (const CameraCorrection& camera : result.camera_corrections) {
    const double translation_m = camera.mount.value.head<3>().norm(),
                 rotation_rad = camera.mount.value.tail<3>().norm();
    if (!(translation_m < kMostMount_m && rotation_rad < kMostMount_rad &&
          std::abs(camera.offset_s) < kMostOffset_s))
      return text(
          "%s would have to move by %.2f m and %.2f degrees and to be exposed %.1f ms from its "
          "frame; that is another "
          "calibration, not an error of this one",
          camera.name.c_str(), translation_m, rotation_rad * kDegrees, 1e3 * camera.offset_s);
  }
  return "";
}

}  // namespace

AlignResult align_with(const Recording& recording, const std::vector<Track>& tracks,
                       const std::vector<LidarSample>& lidar, const AlignOptions& options,
                       ThreadPool& pool, const ContrastData* contrast) {
  const std::string means = means_of(recording, tracks.size(), lidar.size());
  if (recording.frames.size() < 3)
    throw InsufficientDataError(recording.root, "an alignment needs three frames or more", means);
  if (tracks.size() < kLeastTracks && lidar.size() < kLeastLidarPoints)
    throw InsufficientDataError(
        recording.root,
        text("too little is seen to align by: %d tracks or %d LiDAR points are needed",
             kLeastTracks, kLeastLidarPoints),
        means);
  RigModel model = make_rig_model(recording);
  BundleOptions bundle_options = options.bundle;
  BundleResult bundle = adjust_bundle(&model, tracks, lidar, contrast, bundle_options, pool);
  std::vector<ReadoutEstimate> found_readouts;
  std::vector<std::string> remarks;
  for (;;) {
    const std::vector<std::string> given_up =
        fix_unobservable_readouts(bundle, &found_readouts, &model, &bundle_options);
    if (given_up.empty()) break;
    remarks.insert(remarks.end(), given_up.begin(), given_up.end());
    bundle = adjust_bundle(&model, tracks, lidar, contrast, bundle_options, pool);
  }
  AlignResult result = describe(model, std::move(bundle), lidar.empty());
  result.remarks = std::move(remarks);
  for (const UnobservableTimeOffset& clock : result.bundle.unobservable)
    result.remarks.push_back(
        unobservable_text(result.camera_corrections[clock.camera], clock, options.bundle.priors));
  if (const std::string why = obstacle(recording, result, !tracks.empty()); !why.empty())
    throw InsufficientDataError(recording.root, why, means);
  if (lidar.empty())
    result.remarks.emplace_back(
        "no LiDAR: the scale of the drive and what all cameras share (a turn, a time offset) is "
        "the egomotion's");
  for (std::size_t c = 0; c < result.bundle.cameras.size(); ++c)
    if (result.bundle.cameras[c].used == 0)
      result.remarks.push_back(result.cameras[c].name +
                               ": no image point to use; its mount and time offset are as given");
  if (!recording.ground_truth_frames.empty()) {
    result.initial_vs_ground_truth =
        register_trajectories(recording.frames, recording.ground_truth_frames, recording.root);
    result.aligned_vs_ground_truth =
        register_trajectories(result.frames, recording.ground_truth_frames, recording.root);
  }
  return result;
}

AlignResult align(const Recording& recording, const AlignOptions& options, ThreadPool& pool) {
  const auto start = std::chrono::steady_clock::now();
  if (!recording.metric)
    throw InsufficientDataError(recording.root,
                                "photographs have neither egomotion nor clock; align is for drives",
                                recording.format);
  std::optional<RigImages> images;
  std::vector<Track> tracks;
  if (options.images) {
    images = load_track_images(recording, pool, options.tracks);
    tracks = find_tracks(*images, pool, options.tracks);
  }
  std::vector<LidarSample> lidar;
  if (options.lidar && recording.body_from_lidar) {
    const Scene scene = make_scene(recording, {});
    lidar = load_lidar_samples(recording, scene, read_moving_objects(recording, scene), pool);
  }
  std::optional<ContrastData> contrast;
  if (images && !lidar.empty()) contrast.emplace(*images, lidar);
  AlignResult result = align_with(recording, tracks, subsample_evenly(lidar, kMostPlaneSamples),
                                  options, pool, contrast ? &*contrast : nullptr);
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace redrive
