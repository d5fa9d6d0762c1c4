// SPDX-License-Identifier: Apache-2.0
// redrive align: from a recording to poses and a calibration worth training on, or to a clear
// "cannot".
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "redrive/align/bundle/bundle_adjustment.h"
#include "redrive/align/tracks/tracks.h"
#include "redrive/base/parallel.h"
#include "redrive/recording/recording.h"
#include "redrive/recording/register_trajectories.h"

namespace redrive {

struct AlignOptions {
  bool images = true, lidar = true;  ///< what is used, where the recording has it
  TrackOptions tracks;
  BundleOptions bundle;
};

/// What was changed about one frame's pose, or one camera's mount, with its standard deviation.
struct Correction {
  Vector6d value = Vector6d::Zero(),
           sigma = Vector6d::Zero();  ///< m and rad; axes of the body, or of the sensor
};

struct CameraCorrection {
  std::string name;
  Correction mount;
  Eigen::Vector3d rotation_in_body =
      Eigen::Vector3d::Zero();  ///< the mount's turn about the body's axes: roll, pitch, yaw; rad
  double offset_s = 0;          ///< exposure minus pose
  std::optional<double> offset_sigma_s;  ///< how well it is known; nothing where the drive does not
                                         ///< tell it: then it is as given
  double initial_offset_s = 0;
  double readout_s = 0, initial_readout_s = 0;  ///< of a rolling shutter
  std::optional<double> readout_sigma_s;        ///< where it was sought and found
  Eigen::Vector3d intrinsics =
      Eigen::Vector3d::Zero();  ///< relative change of focal length; principal point, px
};

struct AlignResult {
  std::vector<FramePose> frames;           ///< ECEF, all of the recording
  std::vector<CameraCalibration> cameras;  ///< as Recording::cameras
  /// By frame. Sigmas are those of the trajectory's shape: without the motion of the whole, which
  /// nothing measures, and where there is no LiDAR without its scale, which is the egomotion's.
  std::vector<Correction> corrections;
  std::vector<CameraCorrection> camera_corrections;
  BundleResult bundle;
  /// What the user should know of: no LiDAR, so the scale is the egomotion's; a readout that the
  /// drive does not tell and stays as given.
  std::vector<std::string> remarks;
  std::optional<TrajectoryRegistration> initial_vs_ground_truth,
      aligned_vs_ground_truth;  ///< where the recording ships the truth
  double seconds = 0;
};

/// Throws InsufficientDataError with reason and figures where images and LiDAR do not hold the
/// poses: too little is seen, nothing moves, what is seen does not agree, or corrections are larger
/// than an egomotion's errors. InputError as find_tracks and load_lidar_returns.
AlignResult align(const Recording& recording, const AlignOptions& options, ThreadPool& pool);

/// The same with tracks and LiDAR at hand.
AlignResult align_with(const Recording& recording, const std::vector<Track>& tracks,
                       const std::vector<LidarSample>& lidar, const AlignOptions& options,
                       ThreadPool& pool, const ContrastData* contrast = nullptr);

}  // namespace redrive
