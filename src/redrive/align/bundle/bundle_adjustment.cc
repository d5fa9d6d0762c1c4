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
#include "redrive/recording/register_trajectories.h"

namespace redrive {
namespace {

constexpr double kStartSigma_px =
    4;  // before anything is known; the median of the residuals says more
constexpr double kUsualSigma_px = 0.1;   // Observation::sigma_px of a good point
constexpr double kLeastSigma_px = 0.05;  // no image is better than that
constexpr double kLeastPose_m = 0.01,
                 kLeastPose_rad =
                     3e-4;            // what an egomotion without errors is believed to be good for
constexpr double kCorrelation = 2.5;  // integral of a squared exponential's correlation over time,
                                      // in correlation times: sqrt(2 pi)
// Clocks are asked of the LiDAR's contrast with calibration and poses as given: at night tracks
// turn a camera by more than it is wrong. Where poses are too far off for that, once more when the
// first rounds have put them right.
constexpr int kSecondLook = 2;
constexpr int kRoundsWithout = 3;  // for all else to settle once clocks are back as given
constexpr double kFarOff = 4;      // sigmas at which an observation is left out
constexpr double kSettled_m = 1e-3, kSettled_rad = 3e-5,
                 kSettled_s = 1e-4;  // a round that moves no pose further was the last one

struct TriangulatedTrack {
  int track = 0;
  InverseDepthPoint point;
  std::vector<std::uint8_t> used;  ///< by observation
  std::vector<Eigen::Vector2d> errors;
};

/// Of one observation: the camera's, more where the surroundings of the pixel hold it less than is
/// usual.
double sigma_of(const Observation& seen, const std::vector<double>& sigma_px) {
  return sigma_px[seen.camera] * std::max(1.0, seen.sigma_px / kUsualSigma_px);
}

double median_of(std::vector<double>* values) {
  if (values->empty()) return 0;
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

/// All tracks that have a point with the corrections of now, by track.
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
  std::vector<TriangulatedTrack> located;
  for (auto& entry : found)
    if (entry) located.push_back(std::move(*entry));
  return located;
}

/// Noise of each camera by the median: 0.6745 sigma of a component's absolute value; a point takes
/// three numbers.
std::vector<double> measure_noise(const RigModel& model, const std::vector<Track>& tracks,
                                  const std::vector<TriangulatedTrack>& located) {
  std::vector<std::vector<double>> sizes(model.cameras.size());
  for (const TriangulatedTrack& entry : located) {
    const double n = 2 * static_cast<double>(entry.errors.size());
    if (n < 5) continue;  // two observations agree in all but one number
    for (std::size_t i = 0; i < entry.errors.size(); ++i)
      for (int k = 0; k < 2; ++k)
        sizes[tracks[entry.track].seen[i].camera].push_back(std::abs(entry.errors[i][k]) *
                                                            std::sqrt(n / (n - 3)));
  }
  std::vector<double> sigma_px;
  for (std::vector<double>& of_camera : sizes)
    sigma_px.push_back(of_camera.size() < 20
                           ? kStartSigma_px
                           : std::max(kLeastSigma_px, median_of(&of_camera) / 0.6745));
  return sigma_px;
}

/// Leaves out what is far off, and tracks with fewer than two observations left.
void leave_out_far_off(const std::vector<Track>& tracks, const std::vector<double>& sigma_px,
                       std::vector<TriangulatedTrack>* located) {
  std::vector<TriangulatedTrack> kept;
  for (TriangulatedTrack& entry : *located) {
    int used = 0;
    for (std::size_t i = 0; i < entry.errors.size(); ++i) {
      entry.used[i] =
          entry.errors[i].norm() <= kFarOff * sigma_of(tracks[entry.track].seen[i], sigma_px);
      used += entry.used[i];
    }
    if (used >= 2) kept.push_back(std::move(entry));
  }
  *located = std::move(kept);
}

/// The problem of one round.
class Round {
 public:
  /// `unobservable`: their clocks stay as they are.
  Round(RigModel* model, const std::vector<Track>& tracks, const std::vector<LidarSample>& lidar,
        const BundleOptions& options, const std::vector<UnobservableTimeOffset>& unobservable,
        std::size_t landmarks)
      : model_(*model),
        tracks_(tracks),
        lidar_(lidar),
        options_(options),
        unobservable_(unobservable),
        problem_(problem_options()) {
    landmarks_.reserve(landmarks);  // Ceres keeps pointers
  }

  void add(std::vector<TriangulatedTrack>* located, const std::vector<double>& sigma_px) {
    const ExposureMotions times(model_);
    for (TriangulatedTrack& entry : *located) {
      double* const point = landmark(&entry.point.value);
      for (std::size_t i = 0; i < entry.used.size(); ++i) {
        if (!entry.used[i]) continue;
        const Observation& seen = tracks_[entry.track].seen[i];
        const Instant instant = times.of(seen);
        RigModelCamera& camera = model_.cameras[seen.camera];
        problem_.AddResidualBlock(
            reprojection_cost(camera, instant, seen.pixel, sigma_of(seen, sigma_px), entry.point)
                .release(),
            &image_loss_, model_.correction[instant.segment].data(),
            model_.correction[instant.segment + 1].data(), camera.mount.data(), &camera.offset_s,
            &camera.readout_s, camera.intrinsics.data(), point);
      }
    }
  }

  void add(std::vector<PlanarPatch>* patches) {
    for (PlanarPatch& patch : *patches) {
      double* const plane = landmark(&patch.plane.value);
      for (const int i : patch.samples) {
        const Instant instant = model_.at(lidar_[i].t_ns);
        problem_.AddResidualBlock(
            point_to_plane_cost(instant, lidar_[i].in_body, patch.sigma_m, patch.plane).release(),
            &lidar_loss_, model_.correction[instant.segment].data(),
            model_.correction[instant.segment + 1].data(), plane);
      }
    }
  }

  void add(const std::vector<ContrastFit>& fits) {
    for (std::size_t c = 0; c < fits.size(); ++c)
      if (fits[c].told)
        problem_.AddResidualBlock(
            scalar_prior_cost(1, 0, fits[c].sigma_s, fits[c].offset_s).release(), nullptr,
            &model_.cameras[c].offset_s);
  }

  void add_priors(const BundlePriors& priors) {
    const double seconds =
                     static_cast<double>(model_.given.back().t_ns - model_.given.front().t_ns) *
                     1e-9,
                 at_a_time = static_cast<double>(model_.given.size()) * kCorrelation *
                             priors.correlation_s / seconds;
    for (std::size_t f = 0; f < model_.correction.size(); ++f) {
      rig_.push_back(model_.correction[f].data());
      problem_.AddResidualBlock(
          pose_prior_cost(priors.pose * std::sqrt(std::max(1.0, at_a_time))).release(), nullptr,
          model_.correction[f].data());
      if (f == 0) continue;
      const double step_s =
          static_cast<double>(model_.given[f].t_ns - model_.given[f - 1].t_ns) * 1e-9;
      problem_.AddResidualBlock(
          smoothness_cost(priors.pose * (step_s / priors.correlation_s)).release(), nullptr,
          model_.correction[f - 1].data(), model_.correction[f].data());
    }
    for (RigModelCamera& camera : model_.cameras) {
      rig_.push_back(camera.mount.data());
      for (int k = 0; k < 6; ++k)  // a position is measured with a rule; an angle is not, and one
                                   // camera may have been knocked
        problem_.AddResidualBlock(scalar_prior_cost(6, k, priors.mount[k]).release(),
                                  k < 3 ? nullptr : &prior_loss_, camera.mount.data());
    }
    auto at = static_cast<int>(6 * (model_.correction.size() + model_.cameras.size()));
    const auto seek = [&](bool sought, double* number, std::vector<std::optional<int>>* places) {
      places->push_back(sought ? std::optional(at++) : std::nullopt);
      if (sought)
        rig_.push_back(number);
      else
        problem_.SetParameterBlockConstant(number);
    };
    for (std::size_t c = 0; c < model_.cameras.size(); ++c) {
      RigModelCamera& camera = model_.cameras[c];
      problem_.AddResidualBlock(
          scalar_prior_cost(1, 0, priors.offset_s, camera.initial_offset_s()).release(),
          &prior_loss_, &camera.offset_s);
      seek(std::ranges::find(unobservable_, static_cast<int>(c), &UnobservableTimeOffset::camera) ==
               unobservable_.end(),
           &camera.offset_s, &offset_index_);
    }
    for (std::size_t c = 0; c < model_.cameras.size(); ++c) {
      RigModelCamera& camera = model_.cameras[c];
      problem_.AddResidualBlock(
          scalar_prior_cost(1, 0, priors.readout_s, camera.initial_readout_s()).release(), nullptr,
          &camera.readout_s);
      seek(options_.seeks_readout(c), &camera.readout_s, &readout_index_);
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
    // One thread: with more the order of sums, and so the last digits, would differ from run to
    // run.
    solver.num_threads = 1;
    solver.max_num_iterations = iterations;
    solver.function_tolerance = 1e-7;
    solver.logging_type = ceres::SILENT;
    solver.linear_solver_type = points_.empty()      ? ceres::SPARSE_NORMAL_CHOLESKY
                                : rig_.size() <= 200 ? ceres::DENSE_SCHUR
                                                     : ceres::SPARSE_SCHUR;
    solver.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    for (double* point : points_) solver.linear_solver_ordering->AddElementToGroup(point, 0);
    for (Vector6d& correction : model_.correction)
      solver.linear_solver_ordering->AddElementToGroup(correction.data(), 1);
    for (RigModelCamera& camera : model_.cameras)
      for (double* block :
           {camera.mount.data(), &camera.offset_s, &camera.readout_s, camera.intrinsics.data()})
        solver.linear_solver_ordering->AddElementToGroup(block, 2);
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &problem_, &summary);
    for (std::size_t i = 0; i < targets_.size(); ++i) *targets_[i] = landmarks_[i];
    return summary;
  }

  /// What the terms say of how sure all of it is.
  void measure_certainty(BundleResult* result) {
    ReducedCovariance covariance = reduced_covariance(problem_, rig_, points_);
    result->covariance = std::move(covariance.matrix);
    result->variance = std::move(covariance.variance);
    result->offset_index = offset_index_;
    result->readout_index = readout_index_;
  }

 private:
  /// The block that stands for `target` while it is solved. Within a group Ceres orders blocks by
  /// their addresses: side by side in one array they are in the same order in every run, and so are
  /// the sums.
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

BundlePriors priors_of_round(const BundlePriors& given, const RigModel& model, int round) {
  BundlePriors priors = given;
  if (round < 2) return priors;
  double squares_m = 0, squares_rad = 0;
  for (const Vector6d& correction : model.correction) {
    squares_m += correction.head<3>().squaredNorm();
    squares_rad += correction.tail<3>().squaredNorm();
  }
  const double n = 3 * static_cast<double>(model.correction.size());
  priors.pose.head<3>() =
      given.pose.head<3>().cwiseMin(std::max(kLeastPose_m, 1.5 * std::sqrt(squares_m / n)));
  priors.pose.tail<3>() =
      given.pose.tail<3>().cwiseMin(std::max(kLeastPose_rad, 1.5 * std::sqrt(squares_rad / n)));
  return priors;
}

double patch_distance_m(const RigModel& model, const LidarSample& sample,
                        const PlaneParameters& plane) {
  const Eigen::Vector3d from_centre =
      model.corrected(model.at(sample.t_ns)) * sample.in_body - plane.centre;
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

/// The rest of each patch's points from the plane through them that the poses as given make.
double initial_plane_rms_m(const RigModel& model, const std::vector<LidarSample>& lidar,
                           const std::vector<PlanarPatch>& patches) {
  RigModel given = model;
  for (Vector6d& correction : given.correction) correction.setZero();
  std::vector<double> distances;
  for (const PlanarPatch& patch : patches) {
    Eigen::MatrixXd a(patch.samples.size(), 3);
    Eigen::VectorXd b(patch.samples.size());
    for (std::size_t i = 0; i < patch.samples.size(); ++i) {
      const LidarSample& sample = lidar[patch.samples[i]];
      const Eigen::Vector3d x =
          patch.plane.axes.transpose() *
          (given.corrected(given.at(sample.t_ns)) * sample.in_body - patch.plane.centre);
      a.row(i) << x.x(), x.y(), 1;
      b[i] = x.z();
    }
    const Eigen::VectorXd rest = b - a * a.colPivHouseholderQr().solve(b);
    distances.insert(distances.end(), rest.data(), rest.data() + rest.size());
  }
  return rms(distances);
}

/// With nothing corrected.
RigModel with_initial_values(RigModel model) {
  for (Vector6d& correction : model.correction) correction.setZero();
  for (RigModelCamera& camera : model.cameras) {
    camera.mount.setZero();
    camera.intrinsics.setZero();
    camera.offset_s = camera.initial_offset_s();
    camera.readout_s = camera.initial_readout_s();
  }
  return model;
}

void fill_result(const RigModel& model, const std::vector<Track>& tracks,
                 const std::vector<LidarSample>& lidar,
                 const std::vector<TriangulatedTrack>& located,
                 const std::vector<PlanarPatch>& patches, const std::vector<double>& sigma_px,
                 ThreadPool& pool, BundleResult* result) {
  result->cameras.assign(model.cameras.size(), {});
  result->observations_in_frame.assign(model.given.size(), 0);
  for (const Track& track : tracks)
    for (const Observation& seen : track.seen) ++result->cameras[seen.camera].observations;

  const RigModel given = with_initial_values(model);  // the same tracks, and no less robust
  std::vector<Track> used;
  for (const TriangulatedTrack& entry : located) {
    used.emplace_back();
    for (std::size_t i = 0; i < entry.used.size(); ++i)
      if (entry.used[i]) used.back().seen.push_back(tracks[entry.track].seen[i]);
  }
  const ExposureMotions now(model), before(given);
  const std::vector<double> wide(model.cameras.size(), kStartSigma_px);
  std::vector<std::optional<InverseDepthPoint>> given_points(used.size());
  pool.run_ranges(used.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      given_points[i] = fit_inverse_depth_point(given, before, used[i], wide);
  });
  for (std::size_t t = 0; t < used.size(); ++t) {
    if (!given_points[t]) continue;
    const auto errors = reprojection_errors(model, now, used[t], located[t].point);
    const auto errors_before = reprojection_errors(given, before, used[t], *given_points[t]);
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
  result->tracks = static_cast<int>(located.size());
  result->patches = static_cast<int>(patches.size());
  const std::vector<double> distances = patch_distances_m(model, lidar, patches);
  result->lidar_points = static_cast<int>(distances.size());
  result->lidar_rms_m = rms(distances);
  result->initial_lidar_rms_m = initial_plane_rms_m(model, lidar, patches);
}

/// Observations by camera.
std::vector<int> count_used(const std::vector<Track>& tracks,
                            const std::vector<TriangulatedTrack>& located, std::size_t cameras) {
  std::vector<int> used(cameras);
  for (const TriangulatedTrack& entry : located)
    for (std::size_t i = 0; i < entry.used.size(); ++i)
      used[tracks[entry.track].seen[i].camera] += entry.used[i];
  return used;
}

bool all_observable(const std::vector<ContrastFit>& fits) {
  return std::ranges::all_of(fits, &ContrastFit::told);
}

/// The new ones of cameras that have said nothing yet.
void keep_observable(const std::vector<ContrastFit>& fits, std::vector<ContrastFit>* kept) {
  kept->resize(fits.size());
  for (std::size_t c = 0; c < fits.size(); ++c)
    if (!(*kept)[c].told) (*kept)[c] = fits[c];
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
    std::vector<TriangulatedTrack> located = triangulate_tracks(*model, tracks, sigma_px, pool);
    sigma_px = measure_noise(*model, tracks, located);
    leave_out_far_off(tracks, sigma_px, &located);

    // While the poses are off by decimetres, what is flat looks thick.
    PlaneOptions planes = options.planes;
    planes.max_plane_sigma_m *= round == 0 ? 3 : round == 1 ? 1.5 : 1;
    std::vector<PlanarPatch> patches;
    if (!lidar.empty() && (round > 0 || tracks.empty()))
      patches = find_planar_patches(*model, lidar, planes, pool);
    if (contrast && (round == 0 || (round == kSecondLook && !all_observable(result.contrast)))) {
      std::vector<ContrastFit> fits = fit_time_offsets(*model, *contrast, pool);
      for (std::size_t c = 0; c < fits.size();
           ++c)  // what is bright is low in the image: its rows' time looks like the clock's
        if (round == 0 && options.seeks_readout(c)) fits[c].told = false;
      keep_observable(fits, &result.contrast);
    }
    Round problem(model, tracks, lidar, options, result.unobservable,
                  located.size() + patches.size());
    problem.add(&located, sigma_px);
    problem.add(&patches);
    problem.add(result.contrast);
    problem.add_priors(priors_of_round(options.priors, *model, round));
    const ceres::Solver::Summary summary = problem.solve(round == 0 ? 20 : 12);

    // Of the shape: the whole is held by next to nothing, and where it is does not matter.
    const TrajectoryRegistration moved =
        register_trajectories(model->corrected_frames(), before.corrected_frames(), "");
    const double translation_m = moved.residual_m,
                 rotation_rad = moved.residual_deg * std::numbers::pi / 180;
    result.rounds = round + 1;
    result.last_translation_m = translation_m;
    result.last_rotation_rad = rotation_rad;
    double shifted_s = 0;
    for (std::size_t c = 0; c < model->cameras.size(); ++c) {
      const RigModelCamera &now = model->cameras[c], &then = before.cameras[c];
      shifted_s = std::max({shifted_s, std::abs(now.offset_s - then.offset_s),
                            std::abs(now.readout_s - then.readout_s) / 2});
    }
    result.converged = round >= 3 && translation_m < kSettled_m && rotation_rad < kSettled_rad &&
                       shifted_s < kSettled_s;
    if (options.say) {
      std::printf("round %d: %zu of %zu tracks,", round + 1, located.size(), tracks.size());
      for (const double s : sigma_px) std::printf(" %.2f", s);
      const std::vector<double> distances = patch_distances_m(*model, lidar, patches);
      std::printf(
          " px; %zu LiDAR points on %zu patches, %.2f cm; poses moved by %.2f cm, %.4f deg RMS; %d "
          "steps, %.1f s\n",
          distances.size(), patches.size(), 100 * rms(distances), 100 * translation_m,
          rotation_rad * 57.29578, summary.num_successful_steps, summary.total_time_in_seconds);
      for (std::size_t c = 0; c < model->cameras.size(); ++c)
        if (options.seeks_readout(c))
          std::printf("  readout of %s: %.2f ms\n", model->cameras[c].given.name.c_str(),
                      1e3 * model->cameras[c].readout_s);
      std::fflush(stdout);
    }
    if (!offsets_judged && (result.converged || 2 * (round + 1) >= rounds)) {
      offsets_judged = true;
      problem.measure_certainty(&result);
      result.unobservable = unobservable_time_offsets(
          *model, result, count_used(tracks, located, model->cameras.size()),
          options.priors.offset_s, !lidar.empty());
      for (const UnobservableTimeOffset& clock : result.unobservable) {
        model->cameras[clock.camera].offset_s = model->cameras[clock.camera].initial_offset_s();
        result.converged = false;
        rounds = std::max(rounds, round + 1 + kRoundsWithout);
      }
    }
    if (!result.converged && round + 1 < rounds) continue;
    problem.measure_certainty(&result);
    fill_result(*model, tracks, lidar, located, patches, sigma_px, pool, &result);
  }
  return result;
}

}  // namespace redrive
