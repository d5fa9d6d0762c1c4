// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment of a rig: changes a RigModel until image points and planar patches of the LiDAR
// agree with it and with each other. Each round computes the motion at each observation's time,
// triangulates the points and finds the patches and the points on them again, measures the noise,
// rejects outliers, and solves.
#pragma once

#include <optional>
#include <vector>

#include "redrive/align/lidar/contrast.h"
#include "redrive/align/lidar/planes.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/align/tracks/tracks.h"
#include "redrive/base/parallel.h"
#include "redrive/math/angles.h"

namespace redrive {

/// Standard deviations of the priors.
struct BundlePriors {
  /// Egomotion: an upper bound. From the third round on 1.5 times the RMS of the corrections so far
  /// replaces it if that is less. Errors of the egomotion are about constant over correlation_s, so
  /// that poses within that time count as one.
  Vector6d pose = (Vector6d() << 0.5, 0.5, 0.5, 0.0175, 0.0175, 0.0175).finished();
  double correlation_s = 0.7;
  /// Extrinsics of a camera. For its angles and its time offset these are scales of a Cauchy
  /// distribution: most cameras are as calibrated, one may be far off.
  Vector6d extrinsics = (Vector6d() << 0.01, 0.01, 0.01, 0.0005, 0.0005, 0.0005).finished();
  double offset_s = 0.002;
  double readout_s = 0.03;  ///< weak; for estimated readouts only
  Eigen::Vector3d intrinsics{0.003, 2, 2};
  double lidar_elevation_rad = 0.0035;  ///< weak
};

/// Largest standard deviation of an observable offset of the LiDAR's elevations.
inline constexpr double kMaxElevationSigma_rad = 0.03 * kRadiansPerDegree;

/// An unobservable time offset, which keeps its initial value: the best fit and its standard
/// deviation by the residual terms alone.
struct UnobservableTimeOffset {
  int camera = 0;
  double offset_s = 0, sigma_s = 0;
  bool by_edges = false;  ///< whether edges of LiDAR depth contradict it
};

struct BundleOptions {
  BundlePriors priors;
  bool intrinsics = false;  ///< whether to estimate focal length and principal point
  /// one per camera: whether to estimate the readout; empty: none is estimated
  std::vector<bool> readouts;
  PlaneOptions planes;
  std::vector<UnobservableTimeOffset> held_offsets;  ///< known to be unobservable
  bool lidar_elevation = false;  ///< whether to estimate an angle that all elevations are off by
  bool fixed_cameras = false;    ///< whether the sensors' calibration keeps its initial values
  int rounds = 10;       ///< at most; fewer once poses move by less than a tenth of their sigma
  bool verbose = false;  ///< prints one line a round

  bool estimates_readout(std::size_t camera) const {
    return camera < readouts.size() && readouts[camera];
  }
};

/// Reprojection errors of one camera.
struct CameraFit {
  int observations = 0, used = 0;
  /// RMS over used observations, with initial and final poses
  double initial_px = 0, aligned_px = 0;
  double sigma_px = 0;  ///< robust, from the median
  double ties_m = 0;    ///< median distance of its tied points from the LiDAR's surfaces
};

/// A number of a camera's extrinsics that keeps its initial value: the best fit and its standard
/// deviation (unobservable_extrinsics.h).
struct UnobservableExtrinsic {
  int camera = 0;
  int axis = 0;                  ///< forward, left, up, roll, pitch, yaw, of the body
  double change = 0, sigma = 0;  ///< m or rad
};

/// Residuals of one observation, for plots.
struct ImageResidual {
  int camera = 0, frame = 0;
  Eigen::Vector2d pixel, initial_px, aligned_px;
};

struct BundleResult {
  std::vector<CameraFit> cameras;
  std::vector<ImageResidual> residuals;             ///< inliers only
  int tracks = 0, lidar_points = 0, patches = 0;    ///< inliers
  double initial_lidar_rms_m = 0, lidar_rms_m = 0;  ///< distance of LiDAR points to their planes
  std::vector<int> ties_of_camera;         ///< one per camera: points tied to surfaces of the LiDAR
  std::vector<ContrastFit> contrast;       ///< one per camera; empty: not computed
  std::vector<int> observations_in_frame;  ///< one per frame
  /// Indices of frames whose observations contradict every pose that was tried: they stand between
  /// their neighbours, and the covariance does not hold for them.
  std::vector<int> unsupported_frames;
  bool converged = false;
  int rounds = 0;
  double last_translation_m = 0,
         last_rotation_rad = 0;  ///< RMS change of the trajectory's shape in the last round; at
                                 ///< least the change of the LiDAR's elevation
  double last_time_s = 0;        ///< largest change of a time offset or of half a readout there
  std::vector<UnobservableTimeOffset> unobservable;
  std::vector<UnobservableExtrinsic> unobservable_extrinsics;
  /// Standard deviation of the LiDAR's elevation where it was estimated, also of an unobservable
  /// one, which is 0: `unobservable_elevation_rad` is its best fit.
  std::optional<double> elevation_sigma_rad, unobservable_elevation_rad;
  /// Covers pose corrections (6 a frame), extrinsics (6 a camera), and then each camera's other
  /// estimated numbers.
  Eigen::MatrixXd covariance;
  Eigen::MatrixXd robust_covariance;  ///< ReducedCovariance::robust, in the same order
  Eigen::VectorXd variance;           ///< ReducedCovariance::variance, likewise
  /// One per camera: the index of its time offset and its readout in these; nothing where they were
  /// not estimated.
  std::vector<std::optional<int>> offset_index, readout_index;
  std::optional<int> elevation_index;  ///< likewise
};

/// `contrast`: nullptr where images are not available. Once converged, at the latest after half of
/// the rounds, unobservable time offsets (unobservable_time_offsets) and unobservable numbers of
/// extrinsics (unobservable_extrinsics) return to their initial values and the other unknowns
/// converge again.
BundleResult adjust_bundle(RigModel* model, const std::vector<Track>& tracks,
                           const std::vector<LidarSample>& lidar, const ContrastData* contrast,
                           const BundleOptions& options, ThreadPool& pool);

}  // namespace redrive
