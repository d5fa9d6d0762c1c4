// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/bundle_adjustment.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include "redrive/align/bundle/adjustment_problem.h"
#include "redrive/align/bundle/inverse_depth_point.h"
#include "redrive/align/bundle/lidar_ties.h"
#include "redrive/align/bundle/unobservable_extrinsics.h"
#include "redrive/align/bundle/unobservable_time_offsets.h"
#include "redrive/math/angles.h"
#include "redrive/recording/register_trajectories.h"

namespace redrive {
namespace {

constexpr double kStartSigma_px = 4;   // in the first round; later the residuals' median
constexpr double kMinSigma_px = 0.05;  // lower bound of the noise of an image
constexpr double kMinPose_m = 0.01,
                 kMinPose_rad = 3e-4;  // lower bounds of the prior of the egomotion
// Time offsets are estimated from the LiDAR's contrast with initial calibration and poses: at night
// tracks rotate a camera by more than its calibration error. Where the initial poses are too far
// off for that, the contrast is evaluated again with the poses of this round.
constexpr int kSecondContrastRound = 2;
constexpr int kRoundsAfterReset = 3;  // to converge again after unobservable numbers were reset
constexpr double kOutlierSigmas = 4;  // standard deviations of an outlier
constexpr double kMaxTied_m = 40;     // distance of points that are tied to surfaces of the LiDAR
constexpr double kConverged_m = 1e-3, kConverged_rad = 3e-5,
                 kConverged_s = 1e-4;  // change of a round that counts as converged

double median_of(std::vector<double>* values) {
  if (values->empty()) return 0;
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

/// All tracks that can be triangulated with the present corrections, by track.
std::vector<TriangulatedTrack> triangulate_tracks(const RigModel& model,
                                                  const std::vector<Track>& tracks,
                                                  const std::vector<double>& sigma_px,
                                                  ThreadPool& pool) {
  const ExposureMotions times(model);
  std::vector<std::optional<TriangulatedTrack>> found(tracks.size());
  pool.run_ranges(tracks.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      if (const auto point = fit_inverse_depth_point(model, times, tracks[i], sigma_px))
        found[i] = TriangulatedTrack{static_cast<int>(i), *point,
                                     std::vector<std::uint8_t>(tracks[i].seen.size(), 1),
                                     reprojection_errors(model, times, tracks[i], *point)};
  });
  std::vector<TriangulatedTrack> triangulated;
  for (auto& entry : found)
    if (entry) triangulated.push_back(std::move(*entry));
  return triangulated;
}

/// Noise of each camera from the median of the components' absolute values, which is 0.6745 sigma.
/// A point takes three degrees of freedom.
std::vector<double> measure_noise(const RigModel& model, const std::vector<Track>& tracks,
                                  const std::vector<TriangulatedTrack>& triangulated) {
  std::vector<std::vector<double>> sizes(model.cameras.size());
  for (const TriangulatedTrack& entry : triangulated) {
    const double n = 2 * static_cast<double>(entry.errors.size());
    if (n < 5) continue;  // two observations leave one degree of freedom
    for (std::size_t i = 0; i < entry.errors.size(); ++i)
      for (int k = 0; k < 2; ++k)
        sizes[tracks[entry.track].seen[i].camera].push_back(std::abs(entry.errors[i][k]) *
                                                            std::sqrt(n / (n - 3)));
  }
  std::vector<double> sigma_px;
  for (std::vector<double>& of_camera : sizes)
    sigma_px.push_back(of_camera.size() < 20
                           ? kStartSigma_px
                           : std::max(kMinSigma_px, median_of(&of_camera) / 0.6745));
  return sigma_px;
}

/// Rejects outliers, and tracks with fewer than two inliers.
void reject_outliers(const std::vector<Track>& tracks, const std::vector<double>& sigma_px,
                     std::vector<TriangulatedTrack>* triangulated) {
  std::vector<TriangulatedTrack> kept;
  for (TriangulatedTrack& entry : *triangulated) {
    int used = 0;
    for (std::size_t i = 0; i < entry.errors.size(); ++i) {
      entry.used[i] = entry.errors[i].norm() <=
                      kOutlierSigmas * sigma_of(tracks[entry.track].seen[i], sigma_px);
      used += entry.used[i];
    }
    if (used >= 2) kept.push_back(std::move(entry));
  }
  *triangulated = std::move(kept);
}

BundlePriors priors_of_round(const BundlePriors& initial, const RigModel& model, int round) {
  BundlePriors priors = initial;
  if (round < 2) return priors;
  double squares_m = 0, squares_rad = 0;
  for (const Vector6d& correction : model.corrections) {
    squares_m += correction.head<3>().squaredNorm();
    squares_rad += correction.tail<3>().squaredNorm();
  }
  const double n = 3 * static_cast<double>(model.corrections.size());
  priors.pose.head<3>() =
      initial.pose.head<3>().cwiseMin(std::max(kMinPose_m, 1.5 * std::sqrt(squares_m / n)));
  priors.pose.tail<3>() =
      initial.pose.tail<3>().cwiseMin(std::max(kMinPose_rad, 1.5 * std::sqrt(squares_rad / n)));
  return priors;
}

double patch_distance_m(const RigModel& model, const LidarSample& sample,
                        const PlaneParameters& plane) {
  const Eigen::Vector3d from_centre =
      model.corrected_pose(model.motion_at(sample.t_ns)) * sample.in_body - plane.centre;
  return (plane.axes * Eigen::Vector3d(plane.value[0], plane.value[1], 1)).dot(from_centre) -
         plane.value[2];
}

std::vector<double> patch_distances_m(const RigModel& model, const std::vector<LidarSample>& lidar,
                                      const std::vector<PlanarPatch>& patches) {
  std::vector<double> distances;
  for (const PlanarPatch& patch : patches)
    for (const int i : patch.samples)
      distances.push_back(patch_distance_m(model, lidar[i], patch.plane));
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
  const std::vector<double> distances = patch_distances_m(model, lidar, patches);
  result->lidar_points = static_cast<int>(distances.size());
  result->lidar_rms_m = rms(distances);
  result->initial_lidar_rms_m = initial_plane_rms_m(model, lidar, patches);
}

/// Inlier observations by camera.
std::vector<int> count_used(const std::vector<Track>& tracks,
                            const std::vector<TriangulatedTrack>& triangulated,
                            std::size_t cameras) {
  std::vector<int> used(cameras);
  for (const TriangulatedTrack& entry : triangulated)
    for (std::size_t i = 0; i < entry.used.size(); ++i)
      used[tracks[entry.track].seen[i].camera] += entry.used[i];
  return used;
}

/// Largest distance of a point from the surface that it is tied to: with poses that are off by
/// decimetres at first.
double max_tie_m(int round) { return round <= 1 ? 0.5 : round == 2 ? 0.3 : 0.15; }

/// Ties of the points to the patches, and their numbers by camera.
std::vector<LidarTie> tie_points(const RigModel& model, const std::vector<Track>& tracks,
                                 const std::vector<TriangulatedTrack>& triangulated,
                                 const std::vector<LidarSample>& lidar,
                                 const std::vector<PlanarPatch>& patches, int round,
                                 BundleResult* result) {
  std::vector<std::optional<Eigen::Vector3d>> points;
  for (const TriangulatedTrack& entry : triangulated)
    points.push_back(position_of(entry.point, kMaxTied_m));
  std::vector<LidarTie> ties = find_lidar_ties(model, lidar, patches, points, max_tie_m(round));
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
    result->cameras[c].ties_m = median_of(&distances_m[c]);
  }
  return ties;
}

/// Finds what is unobservable and returns it to its initial values. Whether there is any.
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
  return !offsets.empty() || !held->extrinsics.empty();
}

HeldNumbers all_numbers(const RigModel& model) {
  HeldNumbers all;
  for (int c = 0; c < static_cast<int>(model.cameras.size()); ++c) {
    all.time_offsets.push_back({c});
    for (int axis = 0; axis < kExtrinsicAxes; ++axis) all.extrinsics.push_back({c, axis});
  }
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

}  // namespace

BundleResult adjust_bundle(RigModel* model, const std::vector<Track>& tracks,
                           const std::vector<LidarSample>& lidar, const ContrastData* contrast,
                           const BundleOptions& options, ThreadPool& pool) {
  BundleResult result;
  std::vector<double> sigma_px(model->cameras.size(), kStartSigma_px);
  int rounds = options.rounds;
  bool tested_observability = options.fixed_cameras;
  HeldNumbers held =
      options.fixed_cameras ? all_numbers(*model) : HeldNumbers{options.held_offsets, {}};
  for (int round = 0; round < rounds && !result.converged; ++round) {
    const RigModel before = *model;
    std::vector<TriangulatedTrack> triangulated =
        triangulate_tracks(*model, tracks, sigma_px, pool);
    sigma_px = measure_noise(*model, tracks, triangulated);
    reject_outliers(tracks, sigma_px, &triangulated);

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
        tie_points(*model, tracks, triangulated, lidar, patches, round, &result);
    AdjustmentProblem problem(model, tracks, lidar, options, held,
                              triangulated.size() + patches.size());
    problem.add(&triangulated, sigma_px, ties);
    problem.add(&patches);
    problem.add(result.contrast);
    problem.add_priors(priors_of_round(options.priors, *model, round));
    const ceres::Solver::Summary summary = problem.solve(round == 0 ? 20 : 12);
    for (const UnobservableExtrinsic& number : held.extrinsics)
      reset_extrinsic(&model->cameras[number.camera], number.axis);

    // Change of the shape: a rigid motion of the whole is next to unobservable and irrelevant.
    const TrajectoryRegistration change =
        register_trajectories(model->corrected_frames(), before.corrected_frames(), "");
    const double translation_m = change.residual_m,
                 rotation_rad = change.residual_deg * std::numbers::pi / 180;
    result.rounds = round + 1;
    result.last_translation_m = translation_m;
    result.last_rotation_rad = rotation_rad;
    double shifted_s = 0;
    for (std::size_t c = 0; c < model->cameras.size(); ++c) {
      const RigModelCamera &now = model->cameras[c], &then = before.cameras[c];
      shifted_s = std::max({shifted_s, std::abs(now.offset_s - then.offset_s),
                            std::abs(now.readout_s - then.readout_s) / 2});
    }
    result.converged = round >= 3 && translation_m < kConverged_m &&
                       rotation_rad < kConverged_rad && shifted_s < kConverged_s;
    if (options.verbose) {
      std::printf("round %d: %zu of %zu tracks,", round + 1, triangulated.size(), tracks.size());
      for (const double s : sigma_px) std::printf(" %.2f", s);
      const std::vector<double> distances = patch_distances_m(*model, lidar, patches);
      std::printf(
          " px; %zu LiDAR points on %zu patches, %.2f cm; %zu tied image points; poses changed by "
          "%.2f cm, %.4f deg RMS; %d steps, %.1f s\n",
          distances.size(), patches.size(), 100 * rms(distances), ties.size(), 100 * translation_m,
          rotation_rad * kDegreesPerRadian, summary.num_successful_steps,
          summary.total_time_in_seconds);
      for (std::size_t c = 0; c < model->cameras.size(); ++c)
        if (options.estimates_readout(c))
          std::printf("  readout of %s: %.2f ms\n", model->cameras[c].initial.name.c_str(),
                      1e3 * model->cameras[c].readout_s);
      std::fflush(stdout);
    }
    if (!tested_observability && (result.converged || 2 * (round + 1) >= rounds)) {
      tested_observability = true;
      problem.compute_covariance(&result);
      if (hold_unobservable(count_used(tracks, triangulated, model->cameras.size()), options.priors,
                            !lidar.empty(), model, &result, &held)) {
        result.converged = false;
        rounds = std::max(rounds, round + 1 + kRoundsAfterReset);
      }
    }
    if (!result.converged && round + 1 < rounds) continue;
    problem.compute_covariance(&result);
    fill_result(*model, tracks, lidar, triangulated, patches, sigma_px, pool, &result);
  }
  return result;
}

}  // namespace redrive
