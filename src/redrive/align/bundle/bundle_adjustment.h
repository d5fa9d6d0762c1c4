// SPDX-License-Identifier: Apache-2.0
// The bundle adjustment of a rig: moves a RigModel until image points and flat patches of the LiDAR
// agree with it, in rounds: place each observation at its time, find the points and patches anew,
// measure the noise, leave out what is far off, solve.
#pragma once

#include <optional>
#include <vector>

#include "redrive/align/lidar/contrast.h"
#include "redrive/align/lidar/planes.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/align/tracks/tracks.h"
#include "redrive/base/parallel.h"

namespace redrive {

/// Standard deviations of what is known before.
struct BundlePriors {
  /// Of the egomotion, at most: from the third round on it is 1.5 times what was corrected so far.
  /// And over what time an error is about the same: so long, poses say nothing new.
  Vector6d pose = (Vector6d() << 0.5, 0.5, 0.5, 0.0175, 0.0175, 0.0175).finished();
  double correlation_s = 0.7;
  /// Of a camera's position; of its angles and its time offset the scale of a Cauchy distribution:
  /// most are as the calibration says, one may be far off.
  Vector6d mount = (Vector6d() << 0.01, 0.01, 0.01, 0.0005, 0.0005, 0.0005).finished();
  double offset_s = 0.002;
  double readout_s =
      0.03;  ///< of a readout that is sought, about what is given: no more than that it is one
  Eigen::Vector3d intrinsics{0.003, 2, 2};
};

struct BundleOptions {
  BundlePriors priors;
  bool intrinsics = false;     ///< focal length and principal point, too
  std::vector<bool> readouts;  ///< of which cameras the readout is sought, too; empty: of none
  PlaneOptions planes;
  int rounds = 10;
  bool say = false;  ///< a line a round on standard output

  bool seeks_readout(std::size_t camera) const {
    return camera < readouts.size() && readouts[camera];
  }
};

/// How well one camera's images agree.
struct CameraFit {
  int observations = 0, used = 0;
  double initial_px = 0,
         aligned_px = 0;  ///< RMS over those used: with the poses as given and as they are now
  double sigma_px = 0;    ///< robust: by the median
};

/// A clock that nothing tells well enough, and that stays as given: what would fit, and how well
/// the terms alone would hold it.
struct UnobservableTimeOffset {
  int camera = 0;
  double offset_s = 0, sigma_s = 0;
};

/// A residual, for the plot.
struct ImageResidual {
  int camera = 0, frame = 0;
  Eigen::Vector2d pixel, initial_px, aligned_px;
};

struct BundleResult {
  std::vector<CameraFit> cameras;
  std::vector<ImageResidual> residuals;  ///< of the observations used
  int tracks = 0;                        ///< used
  int lidar_points = 0, patches = 0;     ///< used
  double initial_lidar_rms_m = 0, lidar_rms_m = 0;
  std::vector<ContrastFit> contrast;       ///< by camera; empty: not looked at
  std::vector<int> observations_in_frame;  ///< observations by frame
  bool converged = false;
  int rounds = 0;
  double last_translation_m = 0,
         last_rotation_rad = 0;  ///< RMS of what the last round did to the trajectory's shape
  std::vector<UnobservableTimeOffset> unobservable;
  /// Of corrections (6 a frame), mounts (6 a camera), and then what cameras have of their own.
  Eigen::MatrixXd covariance;
  Eigen::VectorXd variance;  ///< ReducedCovariance::variance, in the same order
  /// By camera: where its time offset and its readout are in these; nothing where they were not
  /// sought.
  std::vector<std::optional<int>> offset_index, readout_index;
};

/// `contrast`: nullptr where there are no images at hand. Once settled, at the latest after half of
/// the rounds, clocks that neither it nor the tracks tell (unobservable_time_offsets) are put back
/// as given, and all else settles again.
BundleResult adjust_bundle(RigModel* model, const std::vector<Track>& tracks,
                           const std::vector<LidarSample>& lidar, const ContrastData* contrast,
                           const BundleOptions& options, ThreadPool& pool);

}  // namespace redrive
