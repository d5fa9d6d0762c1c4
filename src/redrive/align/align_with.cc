// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/align.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "redrive/align/bundle/doubtful_frames.h"
#include "redrive/align/bundle/shape_covariance.h"
#include "redrive/align/bundle/unobservable_extrinsics.h"
#include "redrive/align/bundle/unobservable_time_offsets.h"
#include "redrive/base/error.h"
#include "redrive/base/formatted.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/summary.h"
#include "redrive/render/recorded_lidar.h"

namespace redrive {
namespace {

// Limits of a usable result. Poses less certain than this make rendered images worse.
constexpr double kMaxSigma_m = 0.08, kMaxSigma_rad = 0.2 / kDegreesPerRadian;
constexpr double kMaxLastChange_m = 0.015,
                 kMaxLastChange_rad = 0.04 / kDegreesPerRadian;  // change in the last round
constexpr double kMinUsed = 0.4;      // share of inliers among the observations
constexpr double kMaxNoise_px = 2.5;  // largest accepted noise of a camera's observations
constexpr double kMaxPose_m = 5,
                 kMaxPose_rad = 6 / kDegreesPerRadian;  // larger than any error of an egomotion
constexpr double kMaxExtrinsics_m = 0.3,
                 kMaxExtrinsics_rad =
                     3 / kDegreesPerRadian;   // larger than any error of a calibration
constexpr double kMaxOffset_s = 0.1;          // beyond, the image belongs to another frame
constexpr double kMaxReadoutSigma_s = 0.004;  // rows usually take 15 to 35 ms
constexpr double kMinReach_m = 1;
constexpr int kMinTracks = 30, kMinLidarPoints = 1000;

/// Describes the amount of input data for messages.
std::string describe_input(const Recording& recording, std::size_t tracks, std::size_t lidar) {
  const double path_length_m =
      recording.frames.empty() ? 0 : summarize_drive(recording.frames).path_length_m;
  return formatted("%zu frames, %.1f m driven, %zu tracks of image points, %zu LiDAR points",
                   recording.frames.size(), path_length_m, tracks, lidar);
}

/// Standard deviations of a pose, with the error that the tracks of neighbouring frames share.
Vector6d sigmas_at(const Eigen::VectorXd& variance, int at) {
  constexpr double kShared_rad = 0.004 * kRadiansPerDegree;
  Vector6d all = variance.segment<6>(at).cwiseMax(0);
  all.tail<3>().array() += kShared_rad * kShared_rad;
  return all.cwiseSqrt();
}

/// Standard deviation of one number, where it was estimated.
std::optional<double> sigma_at(const BundleResult& bundle, const std::optional<int>& at) {
  if (!at) return std::nullopt;
  return std::sqrt(std::max(0.0, bundle.variance[*at]));
}

/// An estimated readout.
struct ReadoutEstimate {
  double value_s = 0, sigma_s = 0;
};

/// Resets unobservable readouts to their initial values, holds them constant from now on, and
/// returns a remark about each. A readout that changes by more than three standard deviations once
/// others are held constant counts as unobservable, too. *before: the estimates of the last call by
/// camera; empty at the first call.
std::vector<std::string> fix_unobservable_readouts(const BundleResult& bundle,
                                                   std::vector<ReadoutEstimate>* before,
                                                   RigModel* model, BundleOptions* options) {
  double interval_s = std::numeric_limits<double>::infinity();
  for (std::size_t f = 1; f < model->initial_frames.size(); ++f)
    interval_s =
        std::min(interval_s, 1e-9 * static_cast<double>(model->initial_frames[f].t_ns -
                                                        model->initial_frames[f - 1].t_ns));
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
    if (now.sigma_s > kMaxReadoutSigma_s)
      why = formatted("known to %.1f ms, 1 sigma; %.0f are needed", 1e3 * now.sigma_s,
                      1e3 * kMaxReadoutSigma_s);
    else if (std::abs(now.value_s) > most_s)
      why = formatted("%.0f ms fit best, and no more than %.0f can be", 1e3 * now.value_s,
                      1e3 * most_s);
    else if (!before->empty() &&
             std::abs(now.value_s - (*before)[c].value_s) > 3 * (*before)[c].sigma_s)
      why = formatted(
          "%.1f ms while other readouts were estimated, %.1f with those at their initial values",
          1e3 * (*before)[c].value_s, 1e3 * now.value_s);
    if (why.empty()) continue;
    camera.readout_s = camera.initial_readout_s();
    options->readouts[c] = false;
    remarks.push_back(
        formatted("%s: the readout is unobservable (%s): it keeps its initial value of %.2f ms",
                  camera.initial.name.c_str(), why.c_str(), 1e3 * camera.readout_s));
  }
  *before = std::move(found);
  return remarks;
}

std::string unobservable_text(const CameraCorrection& camera, const UnobservableTimeOffset& offset,
                              const BundlePriors& priors) {
  if (offset.by_edges)
    return formatted(
        "%s: the time offset is unobservable (%+.1f +- %.1f ms fits best, but edges of the LiDAR's "
        "depth lie better on the images without it): it keeps its initial value of %.2f ms",
        camera.name.c_str(), 1e3 * offset.offset_s, 1e3 * offset.sigma_s, 1e3 * camera.offset_s);
  return formatted(
      "%s: the time offset is unobservable (%+.1f +- %.1f ms fits best, and +- %.1f is needed: at "
      "constant velocity a late exposure looks like a camera further forward): it keeps its "
      "initial value of %.2f ms",
      camera.name.c_str(), 1e3 * offset.offset_s, 1e3 * offset.sigma_s,
      1e3 * max_observable_sigma_s(priors.offset_s), 1e3 * camera.offset_s);
}

AlignResult describe(const RigModel& model, BundleResult bundle, const BundlePriors& priors,
                     bool scale_is_given) {
  AlignResult result;
  const int n = static_cast<int>(model.initial_frames.size()),
            cameras = static_cast<int>(model.cameras.size());
  result.frames = model.corrected_frames();
  const Eigen::VectorXd variance = shape_variance(model, bundle, scale_is_given);
  for (int f = 0; f < n; ++f)
    result.corrections.push_back({model.corrections[f], sigmas_at(variance, 6 * f)});
  const std::vector<int>& unsupported = bundle.unsupported_frames;
  // they are known as well as the neighbours between which they stand
  for (const int f : unsupported) {
    Vector6d& sigma = result.corrections[f].sigma;
    sigma.setZero();
    for (const int step : {-1, 1}) {
      int other = f + step;
      while (std::ranges::binary_search(unsupported, other)) other += step;
      if (other >= 0 && other < n) sigma = sigma.cwiseMax(result.corrections[other].sigma);
    }
    sigma =
        (sigma.cwiseAbs2() + interpolation_sigma(model, unsupported, f).cwiseAbs2()).cwiseSqrt();
  }
  for (int c = 0; c < cameras; ++c) {
    const RigModelCamera& camera = model.cameras[c];
    result.cameras.push_back(model.corrected_calibration(c));
    CameraCorrection correction;
    correction.name = camera.initial.name;
    correction.extrinsics = extrinsics_in_body(camera);
    for (int axis = 0; axis < kExtrinsicAxes; ++axis)
      correction.extrinsic_sigmas[axis] =
          extrinsic_sigma(model, bundle, priors.extrinsics, c, axis);
    correction.offset_s = camera.offset_s;
    correction.initial_offset_s = camera.initial_offset_s();
    correction.offset_sigma_s = time_offset_sigma(model, bundle, priors.offset_s, c);
    correction.readout_s = camera.readout_s;
    correction.initial_readout_s = camera.initial_readout_s();
    correction.readout_sigma_s = sigma_at(bundle, bundle.readout_index[c]);
    correction.intrinsics = camera.intrinsics;
    result.camera_corrections.push_back(correction);
  }
  result.lidar_elevation_rad = model.lidar_elevation_rad;
  if (!bundle.unobservable_elevation_rad)
    result.lidar_elevation_sigma_rad = bundle.elevation_sigma_rad;
  for (const UnobservableExtrinsic& held : bundle.unobservable_extrinsics)
    result.camera_corrections[held.camera].extrinsic_sigmas[held.axis].reset();
  result.bundle = std::move(bundle);
  return result;
}

/// Returns whether the elevations of the LiDAR's returns are its beams'; adds the reason to the
/// remarks where they are not.
bool knows_elevations(const Recording& recording, std::vector<std::string>* remarks) {
  if (recording.lidar_files.empty()) return false;
  std::string why;
  const auto structure = recorded_structure(recording, &why);
  if (structure) why = misfit(*structure).value_or("");
  if (!why.empty()) remarks->push_back("the LiDAR's elevations are not corrected: " + why);
  return why.empty();
}

/// Largest distance of the trajectory from its first frame.
double reach_m(const std::vector<FramePose>& frames) {
  double reach = 0;
  for (const FramePose& frame : frames)
    reach = std::max(reach, (frame.global_from_body.translation() -
                             frames.front().global_from_body.translation())
                                .norm());
  return reach;
}

/// The reason why the result cannot be used, or empty.
std::string obstacle(const Recording& recording, const AlignResult& result, bool images) {
  const BundleResult& bundle = result.bundle;
  if (bundle.lidar_points == 0 &&
      !(std::min(reach_m(recording.frames), reach_m(result.frames)) >= kMinReach_m))
    return formatted(
        "the car stands still (at most %.2f m from its first pose, %.2f m once aligned), and "
        "without LiDAR only motion makes depth observable; %.0f m are needed",
        reach_m(recording.frames), reach_m(result.frames), kMinReach_m);
  if (!(bundle.last_translation_m < kMaxLastChange_m &&
        bundle.last_rotation_rad < kMaxLastChange_rad))
    return formatted(
        "the poses still change by %.1f cm and %.3f degrees a round after %d rounds: the "
        "observations do not agree with one motion",
        100 * bundle.last_translation_m, bundle.last_rotation_rad * kDegreesPerRadian,
        bundle.rounds);
  int all = 0, used = 0;
  for (std::size_t c = 0; c < bundle.cameras.size(); ++c) {
    const CameraFit& fit = bundle.cameras[c];
    all += fit.observations;
    used += fit.used;
    if (fit.used > 0 && fit.sigma_px > kMaxNoise_px)
      return formatted(
          "image points of %s have a reprojection error of %.1f px with the aligned poses; %.1f "
          "are accepted",
          result.cameras[c].name.c_str(), fit.sigma_px, kMaxNoise_px);
  }
  if (images && all > 0 && used < kMinUsed * all)
    return formatted("only %.0f %% of the image points agree with one motion; %.0f %% are needed",
                     100.0 * used / all, 100 * kMinUsed);
  double worst_m = 0, worst_rad = 0;
  std::size_t at_m = 0, at_rad = 0;
  for (std::size_t f = 0; f < result.corrections.size(); ++f) {
    const Correction& c = result.corrections[f];
    if (c.sigma.head<3>().norm() > worst_m) worst_m = c.sigma.head<3>().norm(), at_m = f;
    if (c.sigma.tail<3>().norm() > worst_rad) worst_rad = c.sigma.tail<3>().norm(), at_rad = f;
    if (!(c.value.head<3>().norm() < kMaxPose_m && c.value.tail<3>().norm() < kMaxPose_rad))
      return formatted(
          "frame %lld would need a correction of %.2f m and %.2f degrees; an egomotion with errors "
          "above %.0f m or %.0f degrees is no usable initial value",
          static_cast<long long>(result.frames[f].id), c.value.head<3>().norm(),
          c.value.tail<3>().norm() * kDegreesPerRadian, kMaxPose_m,
          kMaxPose_rad * kDegreesPerRadian);
  }
  if (!(worst_m <= kMaxSigma_m))
    return formatted(
        "the position of frame %lld is not determined: %.1f cm (1 sigma) after the alignment, %.0f "
        "cm are needed",
        static_cast<long long>(recording.frames[at_m].id), 100 * worst_m, 100 * kMaxSigma_m);
  if (!(worst_rad <= kMaxSigma_rad))
    return formatted(
        "the rotation of frame %lld is not determined: %.2f degrees (1 sigma) after the alignment, "
        "%.2f are needed",
        static_cast<long long>(recording.frames[at_rad].id), worst_rad * kDegreesPerRadian,
        kMaxSigma_rad * kDegreesPerRadian);
  for (const CameraCorrection& camera : result.camera_corrections) {
    const double translation_m = camera.extrinsics.head<3>().norm(),
                 rotation_rad = camera.extrinsics.tail<3>().norm();
    if (!(translation_m < kMaxExtrinsics_m && rotation_rad < kMaxExtrinsics_rad &&
          std::abs(camera.offset_s) < kMaxOffset_s))
      return formatted(
          "%s would need a correction of %.2f m and %.2f degrees and a time offset of %.1f ms; "
          "that is another calibration, not an error of this one",
          camera.name.c_str(), translation_m, rotation_rad * kDegreesPerRadian,
          1e3 * camera.offset_s);
  }
  return "";
}

}  // namespace

AlignResult align_with(const Recording& recording, const std::vector<Track>& tracks,
                       const std::vector<LidarSample>& lidar, const AlignOptions& options,
                       ThreadPool& pool, const ContrastData* contrast) {
  const std::string input = describe_input(recording, tracks.size(), lidar.size());
  if (recording.frames.size() < 3)
    throw InsufficientDataError(recording.root, "an alignment needs three frames or more", input);
  if (tracks.size() < kMinTracks && lidar.size() < kMinLidarPoints)
    throw InsufficientDataError(
        recording.root,
        formatted("too few observations to align by: %d tracks or %d LiDAR points are needed",
                  kMinTracks, kMinLidarPoints),
        input);
  RigModel model = make_rig_model(recording);
  BundleOptions bundle_options = options.bundle;
  std::vector<std::string> remarks;
  bundle_options.lidar_elevation =
      !lidar.empty() && !options.bundle.fixed_cameras && knows_elevations(recording, &remarks);
  BundleResult bundle = adjust_bundle(&model, tracks, lidar, contrast, bundle_options, pool);
  std::vector<ReadoutEstimate> found_readouts;
  for (;;) {
    const std::vector<std::string> unobservable =
        fix_unobservable_readouts(bundle, &found_readouts, &model, &bundle_options);
    if (unobservable.empty()) break;
    remarks.insert(remarks.end(), unobservable.begin(), unobservable.end());
    bundle = adjust_bundle(&model, tracks, lidar, contrast, bundle_options, pool);
  }
  AlignResult result = describe(model, std::move(bundle), options.bundle.priors, lidar.empty());
  result.lidar_elevation_rad += first_elevation_rad(recording);
  if (const auto& best_rad = result.bundle.unobservable_elevation_rad)
    remarks.push_back(formatted(
        "the elevations of the LiDAR are unobservable (%+.3f +- %.3f degrees fits best, and "
        "+- %.3f is needed): they stay as they are",
        *best_rad * kDegreesPerRadian, *result.bundle.elevation_sigma_rad * kDegreesPerRadian,
        kMaxElevationSigma_rad * kDegreesPerRadian));
  if (bundle_options.lidar_elevation && recording.lidars.size() > 1)
    remarks.push_back("of several LiDARs only the elevations of " + recording.lidars[0].name +
                      " are corrected");
  result.remarks = std::move(remarks);
  for (const UnobservableTimeOffset& offset : result.bundle.unobservable)
    result.remarks.push_back(
        unobservable_text(result.camera_corrections[offset.camera], offset, options.bundle.priors));
  if (const std::string why = obstacle(recording, result, !tracks.empty()); !why.empty())
    throw InsufficientDataError(recording.root, why, input);
  if (lidar.empty())
    result.remarks.emplace_back(
        "no LiDAR: the scale of the drive, and a rotation and time offset common to all cameras, "
        "are the egomotion's");
  for (std::size_t c = 0; c < result.bundle.cameras.size(); ++c)
    if (result.bundle.cameras[c].used == 0)
      result.remarks.push_back(
          result.cameras[c].name +
          ": no image point to use; its extrinsics and time offset keep their initial values");
  register_with_ground_truth(recording, &result);
  return result;
}

}  // namespace redrive
