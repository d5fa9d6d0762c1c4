// SPDX-License-Identifier: Apache-2.0
// The least-squares problem of one round of the bundle adjustment.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <memory>
#include <span>
#include <vector>

#include <ceres/loss_function.h>

#include "redrive/align/bundle/bundle_adjustment.h"
#include "redrive/align/bundle/cost_functions.h"
#include "redrive/align/bundle/inverse_depth_point.h"
#include "redrive/align/bundle/least_squares.h"
#include "redrive/align/bundle/lidar_ties.h"

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
  /// `model`, `tracks`, `lidar`, `options` and `held` have to outlive the problem.
  AdjustmentProblem(RigModel* model, const std::vector<Track>& tracks,
                    const std::vector<LidarSample>& lidar, const BundleOptions& options,
                    const HeldNumbers& held, ThreadPool& pool);

  /// Adds reprojection errors, and distances of the tied points from the LiDAR's surfaces.
  void add(std::vector<TriangulatedTrack>* triangulated, const std::vector<double>& sigma_px,
           const std::vector<LidarTie>& ties);
  void add(std::vector<PlanarPatch>* patches);
  void add(const std::vector<ContrastFit>& fits);
  /// Comes last.
  void add_priors(const BundlePriors& priors);

  /// Stops where the cost decreases by less than this share.
  LeastSquares::Summary solve(int iterations, double tolerance);
  /// Computes covariances of the rig's parameters.
  void compute_covariance(BundleResult* result);

 private:
  struct CameraBlocks {
    int extrinsics, offset, readout, intrinsics;
  };
  using Terms = std::vector<LeastSquares::Term>;
  /// Adds `n` landmarks that begin at the numbers at(i), each with the terms of(i).
  void add_landmarks(std::size_t n, const std::function<std::array<double, 3>*(std::size_t)>& at,
                     const std::function<Terms(std::size_t)>& of);
  Terms terms_of(const TriangulatedTrack& entry, const std::vector<double>& sigma_px,
                 const ExposureMotions& times, std::span<const LidarTie> ties) const;
  Terms terms_of(const PlanarPatch& patch) const;
  void add_prior(std::unique_ptr<ceres::CostFunction> cost, const ceres::LossFunction* loss,
                 std::initializer_list<int> blocks);

  ThreadPool& pool_;
  RigModel& model_;
  const std::vector<Track>& tracks_;
  const std::vector<LidarSample>& lidar_;
  const BundleOptions& options_;
  const HeldNumbers& held_;
  ceres::CauchyLoss image_loss_{2}, lidar_loss_{2}, prior_loss_{1};
  ceres::CauchyLoss egomotion_loss_{10};  ///< quadratic except for poses that are wrong by far more
  LeastSquares problem_;
  std::vector<int> corrections_;  ///< blocks, by frame
  std::vector<CameraBlocks> cameras_;
  int elevation_ = 0, other_elevation_ = 0;
  bool uses_elevation_ = false;
  std::vector<std::array<double, 3>*> targets_;  ///< where the landmarks' numbers belong
  double other_elevation_rad_ = 0;               ///< held, for LiDARs but the first
};

}  // namespace redrive
