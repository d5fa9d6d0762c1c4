// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/adjustment_problem.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "redrive/align/bundle/inverse_depth_point.h"
#include "redrive/align/bundle/reduced_covariance.h"
#include "redrive/align/bundle/unobservable_extrinsics.h"
#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr double kTypicalSigma_px = 0.1;  // Observation::sigma_px of a well-localised point
constexpr double kCorrelation = 2.5;  // integral of a squared exponential over time, in correlation
                                      // times: sqrt(2 pi)
constexpr double kHeld = 1e-7;        // m and rad: far stronger than any other prior

ceres::Problem::Options problem_options(ceres::EvaluationCallback* evaluation) {
  ceres::Problem::Options options;
  options.evaluation_callback = evaluation;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  return options;
}

}  // namespace

double sigma_of(const Observation& seen, const std::vector<double>& sigma_px) {
  return sigma_px[seen.camera] * std::max(1.0, seen.sigma_px / kTypicalSigma_px);
}

AdjustmentProblem::AdjustmentProblem(RigModel* model, const std::vector<Track>& tracks,
                                     const std::vector<LidarSample>& lidar,
                                     const BundleOptions& options, const HeldNumbers& held,
                                     std::size_t landmarks, ThreadPool& pool)
    : pool_(pool),
      model_(*model),
      tracks_(tracks),
      lidar_(lidar),
      options_(options),
      held_(held),
      evaluation_(pool),
      problem_(problem_options(&evaluation_)) {
  landmarks_.reserve(landmarks);  // Ceres keeps pointers to them
}

void AdjustmentProblem::add(std::vector<TriangulatedTrack>* triangulated,
                            const std::vector<double>& sigma_px,
                            const std::vector<LidarTie>& ties) {
  const ExposureMotions times(model_);
  auto tie = ties.begin();  // in the order of their points
  const int sensors = 1 + static_cast<int>(model_.cameras.size());
  for (std::size_t t = 0; t < triangulated->size(); ++t) {
    TriangulatedTrack& entry = (*triangulated)[t];
    double* const point = landmark(&entry.point.value);
    for (std::size_t i = 0; i < entry.used.size(); ++i) {
      if (!entry.used[i]) continue;
      const Observation& seen = tracks_[entry.track].seen[i];
      const LocalMotion motion = times.of(seen);
      RigModelCamera& camera = model_.cameras[seen.camera];
      add_term(reprojection_cost(camera, motion, seen.pixel, sigma_of(seen, sigma_px), entry.point),
               &image_loss_,
               {model_.corrections[motion.segment].data(),
                model_.corrections[motion.segment + 1].data(), camera.extrinsics.data(),
                &camera.offset_s, &camera.readout_s, camera.intrinsics.data(), point},
               seen.frame * sensors + 1 + seen.camera);
    }
    for (; tie != ties.end() && tie->point == t; ++tie) {
      const LocalMotion motion = model_.motion_at(tie->t_ns);
      add_term(point_on_surface_cost(motion, tie->surface, entry.point), &image_loss_,
               {model_.corrections[motion.segment].data(),
                model_.corrections[motion.segment + 1].data(), point},
               motion.segment * sensors);
    }
  }
}

void AdjustmentProblem::add(std::vector<PlanarPatch>* patches) {
  const int sensors = 1 + static_cast<int>(model_.cameras.size());
  for (PlanarPatch& patch : *patches) {
    double* const plane = landmark(&patch.plane.value);
    for (const int i : patch.samples) {
      const LocalMotion motion = model_.motion_at(lidar_[i].t_ns);
      add_term(
          point_to_plane_cost(motion, {model_.body_from_lidar, lidar_[i].in_body}, patch.sigma_m,
                              patch.plane),
          &lidar_loss_,
          {model_.corrections[motion.segment].data(), model_.corrections[motion.segment + 1].data(),
           plane, lidar_[i].lidar == 0 ? &model_.lidar_elevation_rad : &other_elevation_rad_},
          motion.segment * sensors);
    }
  }
}

void AdjustmentProblem::add(const std::vector<ContrastFit>& fits) {
  for (std::size_t c = 0; c < fits.size(); ++c)
    if (fits[c].observable)
      problem_.AddResidualBlock(
          scalar_prior_cost(1, 0, fits[c].sigma_s, fits[c].offset_s).release(), nullptr,
          &model_.cameras[c].offset_s);
}

void AdjustmentProblem::add_priors(const BundlePriors& priors) {
  const double seconds = static_cast<double>(model_.initial_frames.back().t_ns -
                                             model_.initial_frames.front().t_ns) *
                         1e-9,
               at_a_time = static_cast<double>(model_.initial_frames.size()) * kCorrelation *
                           priors.correlation_s / seconds;
  for (std::size_t f = 0; f < model_.corrections.size(); ++f) {
    rig_.push_back(model_.corrections[f].data());
    problem_.AddResidualBlock(
        pose_prior_cost(priors.pose * std::sqrt(std::max(1.0, at_a_time))).release(),
        &egomotion_loss_, model_.corrections[f].data());
    if (f == 0) continue;
    const double step_s =
        static_cast<double>(model_.initial_frames[f].t_ns - model_.initial_frames[f - 1].t_ns) *
        1e-9;
    problem_.AddResidualBlock(
        smoothness_cost(priors.pose * (step_s / priors.correlation_s)).release(), &egomotion_loss_,
        model_.corrections[f - 1].data(), model_.corrections[f].data());
  }
  for (RigModelCamera& camera : model_.cameras) {
    rig_.push_back(camera.extrinsics.data());
    for (int k = 0; k < 6; ++k)  // robust for angles: one camera may have been knocked
      problem_.AddResidualBlock(scalar_prior_cost(6, k, priors.extrinsics[k]).release(),
                                k < 3 ? nullptr : &prior_loss_, camera.extrinsics.data());
  }
  for (const UnobservableExtrinsic& held : held_.extrinsics) {
    RigModelCamera& camera = model_.cameras[held.camera];
    problem_.AddResidualBlock(
        direction_prior_cost(body_axis_of_extrinsics(camera, held.axis), kHeld).release(), nullptr,
        camera.extrinsics.data());
  }
  auto at = static_cast<int>(6 * (model_.corrections.size() + model_.cameras.size()));
  const auto estimate = [&](bool is_free, double* number) -> std::optional<int> {
    if (!is_free) {
      problem_.SetParameterBlockConstant(number);
      return std::nullopt;
    }
    rig_.push_back(number);
    return at++;
  };
  for (std::size_t c = 0; c < model_.cameras.size(); ++c) {
    RigModelCamera& camera = model_.cameras[c];
    problem_.AddResidualBlock(
        scalar_prior_cost(1, 0, priors.offset_s, camera.initial_offset_s()).release(), &prior_loss_,
        &camera.offset_s);
    offset_index_.push_back(
        estimate(std::ranges::find(held_.time_offsets, static_cast<int>(c),
                                   &UnobservableTimeOffset::camera) == held_.time_offsets.end(),
                 &camera.offset_s));
  }
  for (std::size_t c = 0; c < model_.cameras.size(); ++c) {
    RigModelCamera& camera = model_.cameras[c];
    problem_.AddResidualBlock(
        scalar_prior_cost(1, 0, priors.readout_s, camera.initial_readout_s()).release(), nullptr,
        &camera.readout_s);
    readout_index_.push_back(estimate(options_.estimates_readout(c), &camera.readout_s));
  }
  if (double* const elevation = &model_.lidar_elevation_rad;
      problem_.HasParameterBlock(elevation)) {
    problem_.AddResidualBlock(scalar_prior_cost(1, 0, priors.lidar_elevation_rad).release(),
                              nullptr, elevation);
    elevation_index_ = estimate(options_.lidar_elevation && !held_.lidar_elevation, elevation);
  }
  if (problem_.HasParameterBlock(&other_elevation_rad_))
    problem_.SetParameterBlockConstant(&other_elevation_rad_);
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

ceres::Solver::Summary AdjustmentProblem::solve(int iterations, double tolerance) {
  ceres::Solver::Options solver;
  // One thread: with more, the order of sums and so the last digits differ from run to run.
  solver.num_threads = 1;
  solver.max_num_iterations = iterations;
  solver.function_tolerance = tolerance;
  solver.logging_type = ceres::SILENT;
  solver.linear_solver_type = points_.empty()      ? ceres::SPARSE_NORMAL_CHOLESKY
                              : rig_.size() <= 200 ? ceres::DENSE_SCHUR
                                                   : ceres::SPARSE_SCHUR;
  solver.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (double* point : points_) solver.linear_solver_ordering->AddElementToGroup(point, 0);
  for (Vector6d& correction : model_.corrections)
    solver.linear_solver_ordering->AddElementToGroup(correction.data(), 1);
  for (RigModelCamera& camera : model_.cameras)
    for (double* block :
         {camera.extrinsics.data(), &camera.offset_s, &camera.readout_s, camera.intrinsics.data()})
      solver.linear_solver_ordering->AddElementToGroup(block, 2);
  for (double* const elevation : {&model_.lidar_elevation_rad, &other_elevation_rad_})
    if (problem_.HasParameterBlock(elevation))
      solver.linear_solver_ordering->AddElementToGroup(elevation, 2);
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem_, &summary);
  for (std::size_t i = 0; i < targets_.size(); ++i) *targets_[i] = landmarks_[i];
  return summary;
}

void AdjustmentProblem::compute_covariance(BundleResult* result) {
  ReducedCovariance covariance = reduced_covariance(problem_, rig_, points_, pool_, groups_);
  result->covariance = std::move(covariance.matrix);
  result->robust_covariance = std::move(covariance.robust);
  result->variance = std::move(covariance.variance);
  result->offset_index = offset_index_;
  result->readout_index = readout_index_;
  result->elevation_index = elevation_index_;
}

void AdjustmentProblem::add_term(std::unique_ptr<ceres::CostFunction> cost,
                                 ceres::LossFunction* loss, const std::vector<double*>& parameters,
                                 int group) {
  const ceres::ResidualBlockId id = problem_.AddResidualBlock(
      evaluation_.copy_of(std::move(cost), parameters).release(), loss, parameters);
  groups_[id] = group;
}

double* AdjustmentProblem::landmark(std::array<double, 3>* target) {
  REDRIVE_CHECK_OP(landmarks_.size(), <, landmarks_.capacity());
  landmarks_.push_back(*target);
  targets_.push_back(target);
  points_.push_back(landmarks_.back().data());
  return points_.back();
}

}  // namespace redrive
