// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/bundle_adjustment.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>

#include <ceres/ceres.h>

#include "redrive/align/bundle/inverse_depth_point.h"
#include "redrive/align/bundle/reduced_covariance.h"
#include "redrive/align/bundle/unobservable_time_offsets.h"
#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/recording/register_trajectories.h"

namespace redrive {
namespace {

constexpr double kStartSigma_px = 4;      // in the first round; later the residuals' median
constexpr double kTypicalSigma_px = 0.1;  // Observation::sigma_px of a well-localised point
constexpr double kMinSigma_px = 0.05;     // lower bound of the noise of an image
constexpr double kMinPose_m = 0.01,
                 kMinPose_rad = 3e-4;  // lower bounds of the prior of the egomotion
constexpr double kCorrelation = 2.5;  // integral of a squared exponential over time, in correlation
                                      // times: sqrt(2 pi)
// Time offsets are estimated from the LiDAR's contrast with initial calibration and poses: at night
// tracks rotate a camera by more than its calibration error. Where the initial poses are too far
// off for that, the contrast is evaluated again with the poses of this round.
constexpr int kSecondContrastRound = 2;
constexpr int kRoundsAfterReset = 3;  // to converge again after time offsets were reset
constexpr double kOutlierSigmas = 4;  // standard deviations of an outlier
constexpr double kConverged_m = 1e-3, kConverged_rad = 3e-5,
                 kConverged_s = 1e-4;  // change of a round that counts as converged

struct TriangulatedTrack {
  int track = 0;
  InverseDepthPoint point;
  std::vector<std::uint8_t> used;  ///< by observation
  std::vector<Eigen::Vector2d> errors;
};

/// Standard deviation of one observation: the camera's noise, more where the image around the pixel
/// determines it less than typically.
double sigma_of(const Observation& seen, const std::vector<double>& sigma_px) {
  return sigma_px[seen.camera] * std::max(1.0, seen.sigma_px / kTypicalSigma_px);
}

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

/// The least-squares problem of one round.
class AdjustmentProblem {
 public:
  /// `unobservable`: time offsets that are held constant.
  AdjustmentProblem(RigModel* model, const std::vector<Track>& tracks,
                    const std::vector<LidarSample>& lidar, const BundleOptions& options,
                    const std::vector<UnobservableTimeOffset>& unobservable, std::size_t landmarks)
      : model_(*model),
        tracks_(tracks),
        lidar_(lidar),
        options_(options),
        unobservable_(unobservable),
        problem_(problem_options()) {
    landmarks_.reserve(landmarks);  // Ceres keeps pointers
  }

  void add(std::vector<TriangulatedTrack>* triangulated, const std::vector<double>& sigma_px) {
    const ExposureMotions times(model_);
    for (TriangulatedTrack& entry : *triangulated) {
      double* const point = landmark(&entry.point.value);
      for (std::size_t i = 0; i < entry.used.size(); ++i) {
        if (!entry.used[i]) continue;
        const Observation& seen = tracks_[entry.track].seen[i];
        const LocalMotion motion = times.of(seen);
        RigModelCamera& camera = model_.cameras[seen.camera];
        problem_.AddResidualBlock(
            reprojection_cost(camera, motion, seen.pixel, sigma_of(seen, sigma_px), entry.point)
                .release(),
            &image_loss_, model_.corrections[motion.segment].data(),
            model_.corrections[motion.segment + 1].data(), camera.extrinsics.data(),
            &camera.offset_s, &camera.readout_s, camera.intrinsics.data(), point);
      }
    }
  }

  void add(std::vector<PlanarPatch>* patches) {
    for (PlanarPatch& patch : *patches) {
      double* const plane = landmark(&patch.plane.value);
      for (const int i : patch.samples) {
        const LocalMotion motion = model_.motion_at(lidar_[i].t_ns);
        problem_.AddResidualBlock(
            point_to_plane_cost(motion, lidar_[i].in_body, patch.sigma_m, patch.plane).release(),
            &lidar_loss_, model_.corrections[motion.segment].data(),
            model_.corrections[motion.segment + 1].data(), plane);
      }
    }
  }

  void add(const std::vector<ContrastFit>& fits) {
    for (std::size_t c = 0; c < fits.size(); ++c)
      if (fits[c].observable)
        problem_.AddResidualBlock(
            scalar_prior_cost(1, 0, fits[c].sigma_s, fits[c].offset_s).release(), nullptr,
            &model_.cameras[c].offset_s);
  }

  void add_priors(const BundlePriors& priors) {
    const double seconds = static_cast<double>(model_.initial_frames.back().t_ns -
                                               model_.initial_frames.front().t_ns) *
                           1e-9,
                 at_a_time = static_cast<double>(model_.initial_frames.size()) * kCorrelation *
                             priors.correlation_s / seconds;
    for (std::size_t f = 0; f < model_.corrections.size(); ++f) {
      rig_.push_back(model_.corrections[f].data());
      problem_.AddResidualBlock(
          pose_prior_cost(priors.pose * std::sqrt(std::max(1.0, at_a_time))).release(), nullptr,
          model_.corrections[f].data());
      if (f == 0) continue;
      const double step_s =
          static_cast<double>(model_.initial_frames[f].t_ns - model_.initial_frames[f - 1].t_ns) *
          1e-9;
      problem_.AddResidualBlock(
          smoothness_cost(priors.pose * (step_s / priors.correlation_s)).release(), nullptr,
          model_.corrections[f - 1].data(), model_.corrections[f].data());
    }
    for (RigModelCamera& camera : model_.cameras) {
      rig_.push_back(camera.extrinsics.data());
      for (int k = 0; k < 6; ++k)  // robust for angles: one camera may have been knocked
        problem_.AddResidualBlock(scalar_prior_cost(6, k, priors.extrinsics[k]).release(),
                                  k < 3 ? nullptr : &prior_loss_, camera.extrinsics.data());
    }
    auto at = static_cast<int>(6 * (model_.corrections.size() + model_.cameras.size()));
    const auto estimate = [&](bool is_free, double* number,
                              std::vector<std::optional<int>>* indices) {
      indices->push_back(is_free ? std::optional(at++) : std::nullopt);
      if (is_free)
        rig_.push_back(number);
      else
        problem_.SetParameterBlockConstant(number);
    };
    for (std::size_t c = 0; c < model_.cameras.size(); ++c) {
      RigModelCamera& camera = model_.cameras[c];
      problem_.AddResidualBlock(
          scalar_prior_cost(1, 0, priors.offset_s, camera.initial_offset_s()).release(),
          &prior_loss_, &camera.offset_s);
      estimate(std::ranges::find(unobservable_, static_cast<int>(c),
                                 &UnobservableTimeOffset::camera) == unobservable_.end(),
               &camera.offset_s, &offset_index_);
    }
    for (std::size_t c = 0; c < model_.cameras.size(); ++c) {
      RigModelCamera& camera = model_.cameras[c];
      problem_.AddResidualBlock(
          scalar_prior_cost(1, 0, priors.readout_s, camera.initial_readout_s()).release(), nullptr,
          &camera.readout_s);
      estimate(options_.estimates_readout(c), &camera.readout_s, &readout_index_);
    }
    for (RigModelCamera& camera : model_.cameras) {
      for (int k = 0; k < 3; ++k)
        problem_.AddResidualBlock(scalar_prior_cost(3, k, priors.intrinsics[k]).release(), nullptr,
                                  camera.intrinsics.data());
      if (options_.intrinsics)
        rig_.push_back(camera.intrinsics.data());
      else
        problem_.SetParameterBlockConstant(camera.intrinsics.data());
    }
  }

  ceres::Solver::Summary solve(int iterations) {
    ceres::Solver::Options solver;
    // One thread: with more, the order of sums and so the last digits differ from run to run.
    solver.num_threads = 1;
    solver.max_num_iterations = iterations;
    solver.function_tolerance = 1e-7;
    solver.logging_type = ceres::SILENT;
    solver.linear_solver_type = points_.empty()      ? ceres::SPARSE_NORMAL_CHOLESKY
                                : rig_.size() <= 200 ? ceres::DENSE_SCHUR
                                                     : ceres::SPARSE_SCHUR;
    solver.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    for (double* point : points_) solver.linear_solver_ordering->AddElementToGroup(point, 0);
    for (Vector6d& correction : model_.corrections)
      solver.linear_solver_ordering->AddElementToGroup(correction.data(), 1);
    for (RigModelCamera& camera : model_.cameras)
      for (double* block : {camera.extrinsics.data(), &camera.offset_s, &camera.readout_s,
                            camera.intrinsics.data()})
        solver.linear_solver_ordering->AddElementToGroup(block, 2);
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &problem_, &summary);
    for (std::size_t i = 0; i < targets_.size(); ++i) *targets_[i] = landmarks_[i];
    return summary;
  }

  /// Covariance of the rig's parameters.
  void compute_covariance(BundleResult* result) {
    ReducedCovariance covariance = reduced_covariance(problem_, rig_, points_);
    result->covariance = std::move(covariance.matrix);
    result->variance = std::move(covariance.variance);
    result->offset_index = offset_index_;
    result->readout_index = readout_index_;
  }

 private:
  /// A copy of `target` that is solved instead. Ceres orders the blocks of a group by their
  /// addresses: contiguous copies have the same order, and so the same sums, in every run.
  double* landmark(std::array<double, 3>* target) {
    REDRIVE_CHECK_OP(landmarks_.size(), <, landmarks_.capacity());
    landmarks_.push_back(*target);
    targets_.push_back(target);
    points_.push_back(landmarks_.back().data());
    return points_.back();
  }

  static ceres::Problem::Options problem_options() {
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return options;
  }

  RigModel& model_;
  const std::vector<Track>& tracks_;
  const std::vector<LidarSample>& lidar_;
  const BundleOptions& options_;
  const std::vector<UnobservableTimeOffset>& unobservable_;
  ceres::CauchyLoss image_loss_{2}, lidar_loss_{2}, prior_loss_{1};
  ceres::Problem problem_;
  std::vector<double*> rig_, points_;
  std::vector<std::array<double, 3>> landmarks_;
  std::vector<std::array<double, 3>*> targets_;
  std::vector<std::optional<int>> offset_index_, readout_index_;
};

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
  result->cameras.assign(model.cameras.size(), {});
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
      if (errors_before[i].x() == kUnseen) continue;
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
  bool offsets_judged = false;
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
    AdjustmentProblem problem(model, tracks, lidar, options, result.unobservable,
                              triangulated.size() + patches.size());
    problem.add(&triangulated, sigma_px);
    problem.add(&patches);
    problem.add(result.contrast);
    problem.add_priors(priors_of_round(options.priors, *model, round));
    const ceres::Solver::Summary summary = problem.solve(round == 0 ? 20 : 12);

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
          " px; %zu LiDAR points on %zu patches, %.2f cm; poses changed by %.2f cm, %.4f deg RMS; "
          "%d "
          "steps, %.1f s\n",
          distances.size(), patches.size(), 100 * rms(distances), 100 * translation_m,
          rotation_rad * kDegreesPerRadian, summary.num_successful_steps,
          summary.total_time_in_seconds);
      for (std::size_t c = 0; c < model->cameras.size(); ++c)
        if (options.estimates_readout(c))
          std::printf("  readout of %s: %.2f ms\n", model->cameras[c].initial.name.c_str(),
                      1e3 * model->cameras[c].readout_s);
      std::fflush(stdout);
    }
    if (!offsets_judged && (result.converged || 2 * (round + 1) >= rounds)) {
      offsets_judged = true;
      problem.compute_covariance(&result);
      result.unobservable = unobservable_time_offsets(
          *model, result, count_used(tracks, triangulated, model->cameras.size()),
          options.priors.offset_s, !lidar.empty());
      for (const UnobservableTimeOffset& offset : result.unobservable) {
        model->cameras[offset.camera].offset_s = model->cameras[offset.camera].initial_offset_s();
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
