// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/adjustment_problem.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

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

}  // namespace

double sigma_of(const Observation& seen, const std::vector<double>& sigma_px) {
  return sigma_px[seen.camera] * std::max(1.0, seen.sigma_px / kTypicalSigma_px);
}

AdjustmentProblem::AdjustmentProblem(RigModel* model, const std::vector<Track>& tracks,
                                     const std::vector<LidarSample>& lidar,
                                     const BundleOptions& options, const HeldNumbers& held,
                                     ThreadPool& pool)
    : pool_(pool),
      model_(*model),
      tracks_(tracks),
      lidar_(lidar),
      options_(options),
      held_(held),
      problem_(pool) {
  cameras_.resize(model_.cameras.size());
  for (Vector6d& correction : model_.corrections)
    corrections_.push_back(problem_.add_block(correction.data(), 6));
  for (std::size_t c = 0; c < cameras_.size(); ++c)
    cameras_[c].extrinsics = problem_.add_block(model_.cameras[c].extrinsics.data(), 6);
  for (std::size_t c = 0; c < cameras_.size(); ++c)
    cameras_[c].offset = problem_.add_block(&model_.cameras[c].offset_s, 1);
  for (std::size_t c = 0; c < cameras_.size(); ++c)
    cameras_[c].readout = problem_.add_block(&model_.cameras[c].readout_s, 1);
  elevation_ = problem_.add_block(&model_.lidar_elevation_rad, 1);
  other_elevation_ = problem_.add_block(&other_elevation_rad_, 1);
  for (std::size_t c = 0; c < cameras_.size(); ++c)
    cameras_[c].intrinsics = problem_.add_block(model_.cameras[c].intrinsics.data(), 3);
}

AdjustmentProblem::Terms AdjustmentProblem::terms_of(const TriangulatedTrack& entry,
                                                     const std::vector<double>& sigma_px,
                                                     const ExposureMotions& times,
                                                     std::span<const LidarTie> ties) const {
  const int sensors = 1 + static_cast<int>(cameras_.size());
  Terms terms;
  for (std::size_t i = 0; i < entry.used.size(); ++i) {
    if (!entry.used[i]) continue;
    const Observation& seen = tracks_[entry.track].seen[i];
    const LocalMotion motion = times.of(seen);
    const CameraBlocks& camera = cameras_[seen.camera];
    terms.push_back({.cost = reprojection_cost(model_.cameras[seen.camera], motion, seen.pixel,
                                               sigma_of(seen, sigma_px), entry.point),
                     .loss = &image_loss_,
                     .blocks = {corrections_[motion.segment], corrections_[motion.segment + 1],
                                camera.extrinsics, camera.offset, camera.readout, camera.intrinsics,
                                LeastSquares::kOwnLandmark},
                     .group = seen.frame * sensors + 1 + seen.camera});
  }
  for (const LidarTie& tie : ties) {
    const LocalMotion motion = model_.motion_at(tie.t_ns);
    terms.push_back({.cost = point_on_surface_cost(motion, tie.surface, entry.point),
                     .loss = &image_loss_,
                     .blocks = {corrections_[motion.segment], corrections_[motion.segment + 1],
                                LeastSquares::kOwnLandmark},
                     .group = motion.segment * sensors});
  }
  return terms;
}

void AdjustmentProblem::add(std::vector<TriangulatedTrack>* triangulated,
                            const std::vector<double>& sigma_px,
                            const std::vector<LidarTie>& ties) {
  const ExposureMotions times(model_);
  add_landmarks(
      triangulated->size(), [&](std::size_t t) { return &(*triangulated)[t].point.value; },
      [&](std::size_t t) {
        const auto [first, end] = std::ranges::equal_range(ties, t, {}, &LidarTie::point);
        return terms_of((*triangulated)[t], sigma_px, times, {first, end});
      });
}

AdjustmentProblem::Terms AdjustmentProblem::terms_of(const PlanarPatch& patch) const {
  const int sensors = 1 + static_cast<int>(cameras_.size());
  Terms terms;
  for (const int i : patch.samples) {
    const LocalMotion motion = model_.motion_at(lidar_[i].t_ns);
    terms.push_back(
        {.cost = point_to_plane_cost(motion, {model_.body_from_lidar, lidar_[i].in_body},
                                     patch.sigma_m, patch.plane),
         .loss = &lidar_loss_,
         .blocks = {corrections_[motion.segment], corrections_[motion.segment + 1],
                    LeastSquares::kOwnLandmark,
                    lidar_[i].lidar == 0 ? elevation_ : other_elevation_},
         .group = motion.segment * sensors});
  }
  return terms;
}

void AdjustmentProblem::add(std::vector<PlanarPatch>* patches) {
  for (const PlanarPatch& patch : *patches)
    uses_elevation_ |=
        std::ranges::any_of(patch.samples, [&](int sample) { return lidar_[sample].lidar == 0; });
  add_landmarks(
      patches->size(), [&](std::size_t p) { return &(*patches)[p].plane.value; },
      [&](std::size_t p) { return terms_of((*patches)[p]); });
}

void AdjustmentProblem::add_landmarks(std::size_t n,
                                      const std::function<std::array<double, 3>*(std::size_t)>& at,
                                      const std::function<Terms(std::size_t)>& of) {
  constexpr std::size_t kPerRange = 64;
  std::vector<Terms> all(n);
  pool_.run_ranges(n, kPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) all[i] = of(i);
  });
  for (std::size_t i = 0; i < n; ++i) {
    targets_.push_back(at(i));
    const int landmark = problem_.add_landmark(*at(i));
    for (LeastSquares::Term& term : all[i]) {
      term.landmark = landmark;
      problem_.add(std::move(term));
    }
  }
}

void AdjustmentProblem::add_prior(std::unique_ptr<ceres::CostFunction> cost,
                                  const ceres::LossFunction* loss,
                                  std::initializer_list<int> blocks) {
  LeastSquares::Term term{.cost = std::move(cost), .loss = loss};
  std::ranges::copy(blocks, term.blocks.begin());
  problem_.add(std::move(term));
}

void AdjustmentProblem::add(const std::vector<ContrastFit>& fits) {
  for (std::size_t c = 0; c < fits.size(); ++c)
    if (fits[c].observable)
      add_prior(scalar_prior_cost(1, 0, fits[c].sigma_s, fits[c].offset_s), nullptr,
                {cameras_[c].offset});
}

void AdjustmentProblem::add_priors(const BundlePriors& priors) {
  const double seconds = static_cast<double>(model_.initial_frames.back().t_ns -
                                             model_.initial_frames.front().t_ns) *
                         1e-9,
               at_a_time = static_cast<double>(model_.initial_frames.size()) * kCorrelation *
                           priors.correlation_s / seconds;
  for (std::size_t f = 0; f < model_.corrections.size(); ++f) {
    add_prior(pose_prior_cost(priors.pose * std::sqrt(std::max(1.0, at_a_time))), &egomotion_loss_,
              {corrections_[f]});
    if (f == 0) continue;
    const double step_s =
        static_cast<double>(model_.initial_frames[f].t_ns - model_.initial_frames[f - 1].t_ns) *
        1e-9;
    add_prior(smoothness_cost(priors.pose * (step_s / priors.correlation_s)), &egomotion_loss_,
              {corrections_[f - 1], corrections_[f]});
  }
  for (std::size_t c = 0; c < cameras_.size(); ++c) {
    const RigModelCamera& camera = model_.cameras[c];
    const CameraBlocks& blocks = cameras_[c];
    for (int k = 0; k < 6; ++k)  // robust for angles: one camera may have been knocked
      add_prior(scalar_prior_cost(6, k, priors.extrinsics[k]), k < 3 ? nullptr : &prior_loss_,
                {blocks.extrinsics});
    add_prior(scalar_prior_cost(1, 0, priors.offset_s, camera.initial_offset_s()), &prior_loss_,
              {blocks.offset});
    add_prior(scalar_prior_cost(1, 0, priors.readout_s, camera.initial_readout_s()), nullptr,
              {blocks.readout});
    for (int k = 0; k < 3; ++k)
      add_prior(scalar_prior_cost(3, k, priors.intrinsics[k]), nullptr, {blocks.intrinsics});
    if (std::ranges::find(held_.time_offsets, static_cast<int>(c),
                          &UnobservableTimeOffset::camera) != held_.time_offsets.end())
      problem_.hold(blocks.offset);
    if (!options_.estimates_readout(c)) problem_.hold(blocks.readout);
    if (!options_.intrinsics) problem_.hold(blocks.intrinsics);
  }
  for (const UnobservableExtrinsic& held : held_.extrinsics)
    add_prior(direction_prior_cost(body_axis_of_extrinsics(model_.cameras[held.camera], held.axis),
                                   kHeld),
              nullptr, {cameras_[held.camera].extrinsics});
  add_prior(scalar_prior_cost(1, 0, priors.lidar_elevation_rad), nullptr, {elevation_});
  if (!uses_elevation_ || !options_.lidar_elevation || held_.lidar_elevation)
    problem_.hold(elevation_);
  problem_.hold(other_elevation_);
}

LeastSquares::Summary AdjustmentProblem::solve(int iterations, double tolerance) {
  const LeastSquares::Summary summary = problem_.solve(iterations, tolerance);
  for (std::size_t i = 0; i < targets_.size(); ++i)
    *targets_[i] = problem_.landmark(static_cast<int>(i));
  return summary;
}

void AdjustmentProblem::compute_covariance(BundleResult* result) {
  ReducedCovariance covariance = reduced_covariance(&problem_, pool_);
  result->covariance = std::move(covariance.matrix);
  result->robust_covariance = std::move(covariance.robust);
  result->variance = std::move(covariance.variance);
  result->offset_index.clear();
  result->readout_index.clear();
  for (const CameraBlocks& camera : cameras_) {
    result->offset_index.push_back(problem_.column(camera.offset));
    result->readout_index.push_back(problem_.column(camera.readout));
  }
  result->elevation_index = problem_.column(elevation_);
}

}  // namespace redrive
