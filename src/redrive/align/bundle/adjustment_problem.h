// SPDX-License-Identifier: Apache-2.0
// The least-squares problem of one round of the bundle adjustment.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include <ceres/ceres.h>

#include "redrive/align/bundle/bundle_adjustment.h"
#include "redrive/align/bundle/cost_functions.h"
#include "redrive/align/bundle/lidar_ties.h"
#include "redrive/align/bundle/parallel_evaluation.h"
#include "redrive/align/bundle/reduced_covariance.h"

namespace redrive {

/// A track and its point under the present corrections.
struct TriangulatedTrack {
  int track = 0;
  InverseDepthPoint point;
  std::vector<std::uint8_t> used;  ///< one per observation
  std::vector<Eigen::Vector2d> errors;
};

/// Standard deviation of one observation: the camera's noise, more where the image around the pixel
/// determines it less than typically.
double sigma_of(const Observation& seen, const std::vector<double>& sigma_px);

/// Numbers that keep their initial values.
struct HeldNumbers {
  std::vector<UnobservableTimeOffset> time_offsets;
  std::vector<UnobservableExtrinsic> extrinsics;
  bool lidar_elevation = false;
};

class AdjustmentProblem {
 public:
  /// `model`, `tracks`, `lidar`, `options` and `held` have to outlive the problem. `landmarks`: the
  /// number of points and planes.
  AdjustmentProblem(RigModel* model, const std::vector<Track>& tracks,
                    const std::vector<LidarSample>& lidar, const BundleOptions& options,
                    const HeldNumbers& held, std::size_t landmarks, ThreadPool& pool);

  /// Adds reprojection errors, and distances of the tied points from the LiDAR's surfaces.
  void add(std::vector<TriangulatedTrack>* triangulated, const std::vector<double>& sigma_px,
           const std::vector<LidarTie>& ties);
  void add(std::vector<PlanarPatch>* patches);
  void add(const std::vector<ContrastFit>& fits);
  void add_priors(const BundlePriors& priors);

  /// Stops where the cost decreases by less than this share.
  ceres::Solver::Summary solve(int iterations, double tolerance);
  /// Computes covariances of the rig's parameters.
  void compute_covariance(BundleResult* result);

 private:
  /// Returns a copy of `target` that is solved instead. Ceres orders the blocks of a group by their
  /// addresses: contiguous copies have the same order, and so the same sums, in every run.
  double* landmark(std::array<double, 3>* target);
  /// Adds a residual that is evaluated in parallel. `group`: its value in ResidualGroups.
  void add_term(std::unique_ptr<ceres::CostFunction> cost, ceres::LossFunction* loss,
                const std::vector<double*>& parameters, int group);

  ThreadPool& pool_;
  RigModel& model_;
  const std::vector<Track>& tracks_;
  const std::vector<LidarSample>& lidar_;
  const BundleOptions& options_;
  const HeldNumbers& held_;
  ceres::CauchyLoss image_loss_{2}, lidar_loss_{2}, prior_loss_{1};
  ceres::CauchyLoss egomotion_loss_{10};  ///< quadratic except for poses that are wrong by far more
  ParallelEvaluation evaluation_;
  ceres::Problem problem_;
  std::vector<double*> rig_, points_;
  std::vector<std::array<double, 3>> landmarks_;
  std::vector<std::array<double, 3>*> targets_;
  std::vector<std::optional<int>> offset_index_, readout_index_;
  std::optional<int> elevation_index_;
  double other_elevation_rad_ = 0;  ///< constant, for LiDARs but the first
  ResidualGroups groups_;           ///< residuals of an image, or of the LiDAR between two frames
};

}  // namespace redrive
