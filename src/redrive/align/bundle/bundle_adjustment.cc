// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/bundle_adjustment.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "redrive/align/bundle/adjustment_problem.h"
#include "redrive/align/bundle/agreeing_tracks.h"
#include "redrive/align/bundle/doubtful_frames.h"
#include "redrive/align/bundle/inverse_depth_point.h"
#include "redrive/align/bundle/lidar_ties.h"
#include "redrive/align/bundle/shape_covariance.h"
#include "redrive/align/bundle/unobservable_extrinsics.h"
#include "redrive/align/bundle/unobservable_time_offsets.h"
#include "redrive/base/progress.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/register_trajectories.h"

namespace redrive {
namespace {

constexpr double kMinPose_m = 0.01,
                 kMinPose_rad = 3e-4;  // lower bounds of the prior of the egomotion
// Time offsets are estimated from LiDAR contrast with the initial calibration and poses: at night
// tracks rotate a camera by more than its calibration error. Where the initial poses are too far
// off for that, the contrast is evaluated again with the poses of this round.
constexpr int kSecondContrastRound = 2;
// rounds to converge again after unobservable numbers were reset
constexpr int kRoundsAfterReset = 3;
// Error of an elevation that all returns share: distances and times of the LiDAR.
constexpr double kElevationError_rad = 0.005 * kRadiansPerDegree;
constexpr double kMaxTied_m = 40;  // largest distance of points that are tied to LiDAR surfaces
// share of a frame's observations that agree with its pose below which it is unsupported
constexpr double kUnsupported = 0.25;
// times the median correction: larger ones are no measure of the usual ones
constexpr double kMuchLarger = 5;
constexpr int kLeastRounds = 4;
// Relative decrease of the cost at which a round ends. Early rounds choose their observations anew
// anyway; 1e-7 takes 1.6 times as long and ends within 0.5 mm and 0.0003 degrees (samples/street).
constexpr double kCoarse = 1e-3, kFine = 1e-5;
// A round has converged when it changes poses and times by less than this part of their sigma.
constexpr double kConvergedSigmas = 0.1;
// in multiples of the least change below: standard deviations may exceed it
constexpr double kNear = 10;
constexpr double kConverged_m = 1e-3, kConverged_rad = 3e-5,
                 kConverged_s = 1e-4;  // least change of a round that counts

BundlePriors priors_of_round(const BundlePriors& initial, const RigModel& model, int round) {
  BundlePriors priors = initial;
  if (round < 2) return priors;
  std::vector<double> sizes_m, sizes_rad;
  for (const Vector6d& correction : model.corrections) {
    sizes_m.push_back(correction.head<3>().norm());
    sizes_rad.push_back(correction.tail<3>().norm());
  }
  const double most_m = kMuchLarger * median_or_zero(&sizes_m),
               most_rad = kMuchLarger * median_or_zero(&sizes_rad);
  double squares_m = 0, squares_rad = 0, n = 0;
  for (const Vector6d& correction : model.corrections) {
    if (correction.head<3>().norm() > most_m || correction.tail<3>().norm() > most_rad) continue;
    squares_m += correction.head<3>().squaredNorm();
    squares_rad += correction.tail<3>().squaredNorm();
    n += 3;
  }
  n = std::max(3.0, n);
  priors.pose.head<3>() =
      initial.pose.head<3>().cwiseMin(std::max(kMinPose_m, 1.5 * std::sqrt(squares_m / n)));
  priors.pose.tail<3>() =
      initial.pose.tail<3>().cwiseMin(std::max(kMinPose_rad, 1.5 * std::sqrt(squares_rad / n)));
  return priors;
}

double patch_distance_m(const RigModel& model, const LidarSample& sample,
                        const PlaneParameters& plane) {
  const Eigen::Vector3d from_centre = model.corrected_pose(model.motion_at(sample.t_ns)) *
                                          model.raised(sample.in_body, sample.lidar) -
                                      plane.centre;
  return (plane.axes * Eigen::Vector3d(plane.value[0], plane.value[1], 1)).dot(from_centre) -
         plane.value[2];
}

std::vector<double> patch_distances_m(const RigModel& model, const std::vector<LidarSample>& lidar,
                                      const std::vector<PlanarPatch>& patches, ThreadPool& pool) {
  constexpr std::size_t kPatchesPerRange = 16;
  std::vector<std::size_t> first{0};
  for (const PlanarPatch& patch : patches) first.push_back(first.back() + patch.samples.size());
  std::vector<double> distances(first.back());
  pool.run_ranges(patches.size(), kPatchesPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p)
      for (std::size_t i = 0; i < patches[p].samples.size(); ++i)
        distances[first[p] + i] =
            patch_distance_m(model, lidar[patches[p].samples[i]], patches[p].plane);
  });
  return distances;
}

double rms(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v * v;
  return values.empty() ? 0 : std::sqrt(sum / static_cast<double>(values.size()));
}

/// RMS distance of each patch's points to the plane fitted to them with the initial poses.
double initial_plane_rms_m(const RigModel& model, const std::vector<LidarSample>& lidar,
                           const std::vector<PlanarPatch>& patches) {
  RigModel initial = model;
  for (Vector6d& correction : initial.corrections) correction.setZero();
  initial.lidar_elevation_rad = 0;
  std::vector<double> distances;
  for (const PlanarPatch& patch : patches) {
    Eigen::MatrixXd a(patch.samples.size(), 3);
    Eigen::VectorXd b(patch.samples.size());
    for (std::size_t i = 0; i < patch.samples.size(); ++i) {
      const LidarSample& sample = lidar[patch.samples[i]];
      const Eigen::Vector3d x =
          patch.plane.axes.transpose() *
          (initial.corrected_pose(initial.motion_at(sample.t_ns)) * sample.in_body -
           patch.plane.centre);
      a.row(i) << x.x(), x.y(), 1;
      b[i] = x.z();
    }
    const Eigen::VectorXd residuals = b - a * a.colPivHouseholderQr().solve(b);
    distances.insert(distances.end(), residuals.data(), residuals.data() + residuals.size());
  }
  return rms(distances);
}

/// Returns the model with initial values and without corrections.
RigModel with_initial_values(RigModel model) {
  for (Vector6d& correction : model.corrections) correction.setZero();
  model.lidar_elevation_rad = 0;
  for (RigModelCamera& camera : model.cameras) {
    camera.extrinsics.setZero();
    camera.intrinsics.setZero();
    camera.offset_s = camera.initial_offset_s();
    camera.readout_s = camera.initial_readout_s();
  }
  return model;
}

void fill_result(const RigModel& model, const std::vector<Track>& tracks,
                 const std::vector<LidarSample>& lidar,
                 const std::vector<TriangulatedTrack>& triangulated,
                 const std::vector<PlanarPatch>& patches, const std::vector<double>& sigma_px,
                 ThreadPool& pool, BundleResult* result) {
  result->observations_in_frame.assign(model.initial_frames.size(), 0);
  for (const Track& track : tracks)
    for (const Observation& seen : track.seen) ++result->cameras[seen.camera].observations;

  const RigModel initial = with_initial_values(model);  // the same tracks, equally robust
  std::vector<Track> used;
  for (const TriangulatedTrack& entry : triangulated) {
    used.emplace_back();
    for (std::size_t i = 0; i < entry.used.size(); ++i)
      if (entry.used[i]) used.back().seen.push_back(tracks[entry.track].seen[i]);
  }
  const ExposureMotions now(model), before(initial);
  const std::vector<double> wide(model.cameras.size(), kStartSigma_px);
  std::vector<std::optional<InverseDepthPoint>> initial_points(used.size());
  pool.run_ranges(used.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      initial_points[i] = fit_inverse_depth_point(initial, before, used[i], wide);
  });
  for (std::size_t t = 0; t < used.size(); ++t) {
    if (!initial_points[t]) continue;
    const auto errors = reprojection_errors(model, now, used[t], triangulated[t].point);
    const auto errors_before = reprojection_errors(initial, before, used[t], *initial_points[t]);
    for (std::size_t i = 0; i < used[t].seen.size(); ++i) {
      if (errors_before[i].x() == kUnseen || errors[i].x() == kUnseen) continue;
      const Observation& seen = used[t].seen[i];
      CameraFit& fit = result->cameras[seen.camera];
      ++fit.used;
      ++result->observations_in_frame[seen.frame];
      fit.aligned_px += errors[i].squaredNorm();
      fit.initial_px += errors_before[i].squaredNorm();
      result->residuals.push_back(
          {seen.camera, seen.frame, seen.pixel, errors_before[i], errors[i]});
    }
  }
  for (std::size_t c = 0; c < result->cameras.size(); ++c) {
    CameraFit& fit = result->cameras[c];
    if (fit.used > 0) {
      fit.aligned_px = std::sqrt(fit.aligned_px / fit.used);
      fit.initial_px = std::sqrt(fit.initial_px / fit.used);
    }
    fit.sigma_px = sigma_px[c];
  }
  result->tracks = static_cast<int>(triangulated.size());
  result->patches = static_cast<int>(patches.size());
  const std::vector<double> distances = patch_distances_m(model, lidar, patches, pool);
  result->lidar_points = static_cast<int>(distances.size());
  result->lidar_rms_m = rms(distances);
  result->initial_lidar_rms_m = initial_plane_rms_m(model, lidar, patches);
}

/// Returns the number of inlier observations of each camera.
std::vector<int> count_used(const std::vector<Track>& tracks,
                            const std::vector<TriangulatedTrack>& triangulated,
                            std::size_t cameras) {
  std::vector<int> used(cameras);
  for (const TriangulatedTrack& entry : triangulated)
    for (std::size_t i = 0; i < entry.used.size(); ++i)
      used[tracks[entry.track].seen[i].camera] += entry.used[i];
  return used;
}

/// Returns the largest distance of a point from the surface that it is tied to: poses are off by
/// decimetres at first.
double max_tie_m(int round) { return round <= 1 ? 0.5 : round == 2 ? 0.3 : 0.15; }

/// Returns ties of the points to the patches, and their number for each camera.
std::vector<LidarTie> tie_points(const RigModel& model, const std::vector<Track>& tracks,
                                 const std::vector<TriangulatedTrack>& triangulated,
                                 const std::vector<LidarSample>& lidar,
                                 const std::vector<PlanarPatch>& patches, int round,
                                 ThreadPool& pool, BundleResult* result) {
  std::vector<std::optional<Eigen::Vector3d>> points;
  for (const TriangulatedTrack& entry : triangulated)
    points.push_back(position_of(entry.point, kMaxTied_m));
  std::vector<LidarTie> ties =
      find_lidar_ties(model, lidar, patches, points, max_tie_m(round), pool);
  if (round > 2)
    std::erase_if(ties, [](const LidarTie& tie) {
      return std::abs(tie.distance_m) > kOutlierSigmas * tie.surface.sigma_m;
    });
  result->ties_of_camera.assign(model.cameras.size(), 0);
  std::vector<std::vector<double>> distances_m(model.cameras.size());
  for (const LidarTie& tie : ties) {
    std::vector<std::uint8_t> seen(model.cameras.size());
    const TriangulatedTrack& entry = triangulated[tie.point];
    for (std::size_t i = 0; i < entry.used.size(); ++i)
      if (entry.used[i]) seen[tracks[entry.track].seen[i].camera] = 1;
    for (std::size_t c = 0; c < seen.size(); ++c)
      if (seen[c]) distances_m[c].push_back(std::abs(tie.distance_m));
  }
  result->cameras.resize(model.cameras.size());
  for (std::size_t c = 0; c < model.cameras.size(); ++c) {
    result->ties_of_camera[c] = static_cast<int>(distances_m[c].size());
    result->cameras[c].ties_m = median_or_zero(&distances_m[c]);
  }
  return ties;
}

/// Sets the standard deviation of an estimated elevation.
void note_elevation_sigma(BundleResult* result) {
  if (!result->elevation_index) return;
  const double variance = std::max(0.0, result->variance[*result->elevation_index]);
  result->elevation_sigma_rad = std::hypot(std::sqrt(variance), kElevationError_rad);
}

/// Finds unobservable numbers and resets them to their initial values. Returns whether there are
/// any.
bool hold_unobservable(const std::vector<int>& used, const BundlePriors& priors, bool lidar,
                       RigModel* model, BundleResult* result, HeldNumbers* held) {
  const std::vector<UnobservableTimeOffset> offsets =
      unobservable_time_offsets(*model, *result, used, priors.offset_s, lidar);
  held->time_offsets.insert(held->time_offsets.end(), offsets.begin(), offsets.end());
  held->extrinsics = unobservable_extrinsics(*model, *result, used, priors.extrinsics);
  for (const UnobservableTimeOffset& offset : offsets)
    model->cameras[offset.camera].offset_s = model->cameras[offset.camera].initial_offset_s();
  for (const UnobservableExtrinsic& number : held->extrinsics)
    reset_extrinsic(&model->cameras[number.camera], number.axis);
  result->unobservable = held->time_offsets;
  result->unobservable_extrinsics = held->extrinsics;
  note_elevation_sigma(result);
  held->lidar_elevation =
      result->elevation_sigma_rad && *result->elevation_sigma_rad > kMaxElevationSigma_rad;
  if (held->lidar_elevation)
    result->unobservable_elevation_rad = std::exchange(model->lidar_elevation_rad, 0);
  return !offsets.empty() || !held->extrinsics.empty() || held->lidar_elevation;
}

HeldNumbers all_numbers(const RigModel& model) {
  HeldNumbers all;
  for (int c = 0; c < static_cast<int>(model.cameras.size()); ++c) {
    all.time_offsets.push_back({c});
    for (int axis = 0; axis < kExtrinsicAxes; ++axis) all.extrinsics.push_back({c, axis});
  }
  all.lidar_elevation = true;
  return all;
}

bool all_observable(const std::vector<ContrastFit>& fits) {
  return std::ranges::all_of(fits, &ContrastFit::observable);
}

/// Adds the fits of cameras without an observable one so far.
void keep_observable(const std::vector<ContrastFit>& fits, std::vector<ContrastFit>* kept) {
  kept->resize(fits.size());
  for (std::size_t c = 0; c < fits.size(); ++c)
    if (!(*kept)[c].observable) (*kept)[c] = fits[c];
}

/// Records how much the last round changed the model.
void note_changes(const RigModel& now, const RigModel& before, BundleResult* result) {
  // Compares the shape: a rigid motion of the whole is hardly observable, and irrelevant.
  const TrajectoryRegistration change =
      register_trajectories(now.corrected_frames(), before.corrected_frames(), "");
  result->last_translation_m = change.residual_m;
  result->last_rotation_rad =
      std::max(change.residual_deg * kRadiansPerDegree,
               std::abs(now.lidar_elevation_rad - before.lidar_elevation_rad));
  result->last_time_s = 0;
  for (std::size_t c = 0; c < now.cameras.size(); ++c)
    result->last_time_s = std::max(
        {result->last_time_s, std::abs(now.cameras[c].offset_s - before.cameras[c].offset_s),
         std::abs(now.cameras[c].readout_s - before.cameras[c].readout_s) / 2});
}

/// Whether to compute standard deviations, which takes time, to see if a round changed nothing.
bool is_near_convergence(const BundleResult& result) {
  return result.last_translation_m < kNear * kConverged_m &&
         result.last_rotation_rad < kNear * kConverged_rad &&
         result.last_time_s < kNear * kConverged_s;
}

/// Returns the smallest standard deviation of a time offset or of half a readout; 0 without any.
double least_time_sigma_s(const BundleResult& result) {
  std::vector<double> sigmas_s;
  for (const std::optional<int>& index : result.offset_index)
    if (index) sigmas_s.push_back(std::sqrt(std::max(0.0, result.variance[*index])));
  for (const std::optional<int>& index : result.readout_index)
    if (index) sigmas_s.push_back(std::sqrt(std::max(0.0, result.variance[*index])) / 2);
  return sigmas_s.empty() ? 0 : std::ranges::min(sigmas_s);
}

/// Whether a round changed less than a tenth of the standard deviations, or next to nothing.
bool has_converged(const RigModel& model, bool scale_is_given, const BundleResult& result) {
  const Eigen::VectorXd variance = shape_variance(model, result, scale_is_given);
  double squares_m = 0, squares_rad = 0;
  const auto n = static_cast<Eigen::Index>(model.initial_frames.size());
  for (Eigen::Index f = 0; f < n; ++f) {
    squares_m += variance.segment<3>(6 * f).sum() / static_cast<double>(n);
    squares_rad += variance.segment<3>(6 * f + 3).sum() / static_cast<double>(n);
  }
  return result.last_translation_m <
             std::max(kConverged_m, kConvergedSigmas * std::sqrt(squares_m)) &&
         result.last_rotation_rad <
             std::max(kConverged_rad, kConvergedSigmas * std::sqrt(squares_rad)) &&
         result.last_time_s < std::max(kConverged_s, kConvergedSigmas * least_time_sigma_s(result));
}

struct RoundFigures {
  const RigModel& model;
  const BundleOptions& options;
  const BundleResult& result;
  int most_rounds = 0;
  std::size_t triangulated = 0, tracks = 0;
  const std::vector<double>& sigma_px;
  std::vector<double> distances_m;
  std::size_t patches = 0, ties = 0;
  double seconds = 0;
};

void print_round(const RoundFigures& round) {
  std::printf("round %d of at most %d: %zu of %zu tracks,", round.result.rounds, round.most_rounds,
              round.triangulated, round.tracks);
  for (const double s : round.sigma_px) std::printf(" %.2f", s);
  std::printf(
      " px; %zu LiDAR points on %zu patches, %.2f cm; %zu tied image points; poses changed by "
      "%.2f cm, %.4f deg RMS; %.1f s\n",
      round.distances_m.size(), round.patches, 100 * rms(round.distances_m), round.ties,
      100 * round.result.last_translation_m, round.result.last_rotation_rad * kDegreesPerRadian,
      round.seconds);
  if (round.model.lidar_elevation_rad != 0)
    std::printf("  elevations of the LiDAR: %+.4f deg\n",
                round.model.lidar_elevation_rad * kDegreesPerRadian);
  for (std::size_t c = 0; c < round.model.cameras.size(); ++c)
    if (round.options.estimates_readout(c))
      std::printf("  readout of %s: %.2f ms\n", round.model.cameras[c].initial.name.c_str(),
                  1e3 * round.model.cameras[c].readout_s);
  std::fflush(stdout);
}

}  // namespace

BundleResult adjust_bundle(RigModel* model, const std::vector<Track>& tracks,
                           const std::vector<LidarSample>& lidar, const ContrastData* contrast,
                           const BundleOptions& options, ThreadPool& pool) {
  BundleResult result;
  std::vector<double> sigma_px(model->cameras.size(), kStartSigma_px);
  std::vector<int> restarts(model->initial_frames.size());
  int rounds = options.rounds;
  bool tested_observability = options.fixed_cameras;
  HeldNumbers held =
      options.fixed_cameras ? all_numbers(*model) : HeldNumbers{options.held_offsets, {}, false};
  for (int round = 0; round < rounds && !result.converged; ++round) {
    const Progress progress("round " + std::to_string(round + 1) + " of at most " +
                            std::to_string(rounds));
    const RigModel before = *model;
    AgreeingTracks agreeing = find_agreeing(tracks, sigma_px, pool, model, &restarts);
    std::vector<TriangulatedTrack>& triangulated = agreeing.triangulated;
    sigma_px = agreeing.sigma_px;

    // Poses with errors of decimetres make planes thick.
    PlaneOptions planes = options.planes;
    planes.max_plane_sigma_m *= round == 0 ? 3 : round == 1 ? 1.5 : 1;
    std::vector<PlanarPatch> patches;
    if (!lidar.empty() && (round > 0 || tracks.empty()))
      patches = find_planar_patches(*model, lidar, planes, pool);
    if (contrast &&
        (round == 0 || (round == kSecondContrastRound && !all_observable(result.contrast)))) {
      std::vector<ContrastFit> fits = fit_time_offsets(*model, *contrast, pool);
      for (std::size_t c = 0; c < fits.size();
           ++c)  // bright features lie low in the image, where the readout acts like a time offset
        if (round == 0 && options.estimates_readout(c)) fits[c].observable = false;
      keep_observable(fits, &result.contrast);
    }
    const std::vector<LidarTie> ties =
        tie_points(*model, tracks, triangulated, lidar, patches, round, pool, &result);
    AdjustmentProblem problem(model, tracks, lidar, options, held, pool);
    problem.add(&triangulated, sigma_px, ties);
    problem.add(&patches);
    problem.add(result.contrast);
    problem.add_priors(priors_of_round(options.priors, *model, round));
    const LeastSquares::Summary summary =
        problem.solve(round == 0 ? 20 : 12, round + 1 < kLeastRounds ? kCoarse : kFine);
    for (const UnobservableExtrinsic& number : held.extrinsics)
      reset_extrinsic(&model->cameras[number.camera], number.axis);

    note_changes(*model, before, &result);
    result.rounds = round + 1;
    bool has_covariance = false;
    const auto find_covariance = [&] {
      if (!std::exchange(has_covariance, true)) problem.compute_covariance(&result);
    };
    if (round >= kLeastRounds - 1 && is_near_convergence(result)) {
      find_covariance();
      result.converged = has_converged(*model, lidar.empty(), result);
    }
    if (options.verbose)
      print_round({*model, options, result, rounds, triangulated.size(), tracks.size(), sigma_px,
                   patch_distances_m(*model, lidar, patches, pool), patches.size(), ties.size(),
                   summary.seconds});
    if (!tested_observability && (result.converged || 2 * (round + 1) >= rounds)) {
      tested_observability = true;
      find_covariance();
      if (hold_unobservable(count_used(tracks, triangulated, model->cameras.size()), options.priors,
                            !lidar.empty(), model, &result, &held)) {
        result.converged = false;
        rounds = std::max(rounds, round + 1 + kRoundsAfterReset);
      }
    }
    if (!result.converged && round + 1 < rounds) continue;
    find_covariance();
    note_elevation_sigma(&result);
    result.unsupported_frames = doubtful_frames(agreeing.support, kUnsupported);
    place_between_neighbours(result.unsupported_frames, model);
    fill_result(*model, tracks, lidar, triangulated, patches, sigma_px, pool, &result);
  }
  return result;
}

}  // namespace redrive
