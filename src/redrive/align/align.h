// SPDX-License-Identifier: Apache-2.0
// redrive align: aligns poses and calibration of a recording to its images and LiDAR, or reports
// why that is not possible.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "redrive/align/bundle/bundle_adjustment.h"
#include "redrive/align/lidar/depth_edges.h"
#include "redrive/align/tracks/tracks.h"
#include "redrive/base/parallel.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/core/register_trajectories.h"

namespace redrive {

struct AlignOptions {
  bool images = true, lidar = true;  ///< whether to use them where the recording has them
  TrackOptions tracks;
  BundleOptions bundle;
  /// Frames that are aligned at a time: a longer drive is cut into windows that overlap
  /// (windows.h), so that time and memory are linear in its length. At least kMinWindow; 0: never
  /// cut.
  int window = 400;
};
inline constexpr int kMinWindow = 10;

/// The correction of one frame's pose, with its standard deviation: forward, left, up (m), roll,
/// pitch, yaw (rad), in the axes of the body.
struct Correction {
  /// sigma^2: variance of the residuals, at least as correlated within a point, patch, image or
  /// scan (reduced_covariance.h), without motions of the whole; for rotations plus (0.004
  /// degrees)^2, the error that the tracks of neighbouring frames share.
  Vector6d value = Vector6d::Zero(), sigma = Vector6d::Zero();
};

struct CameraCorrection {
  std::string name;
  Vector6d extrinsics = Vector6d::Zero();  ///< as Correction::value
  /// Standard deviations of `extrinsics` (extrinsic_sigma); nothing: unobservable, the initial
  /// value is kept.
  std::array<std::optional<double>, 6> extrinsic_sigmas;
  double offset_s = 0, initial_offset_s = 0;  ///< exposure minus time of the pose
  /// Standard deviation (time_offset_sigma); nothing: unobservable, the initial value is kept.
  std::optional<double> offset_sigma_s;
  double readout_s = 0, initial_readout_s = 0;  ///< readout time of a rolling shutter
  std::optional<double> readout_sigma_s;        ///< where the readout was estimated
  Eigen::Vector3d intrinsics =
      Eigen::Vector3d::Zero();  ///< relative change of focal length; principal point, px
};

struct AlignResult {
  std::vector<FramePose> frames;           ///< all frames of the recording
  std::vector<CameraCalibration> cameras;  ///< as Recording::cameras
  /// One per frame. Sigmas belong to the trajectory's shape: they exclude a rigid motion of the
  /// whole, which nothing measures, and without LiDAR the scale, which is the egomotion's.
  std::vector<Correction> corrections;
  std::vector<CameraCorrection> camera_corrections;
  double lidar_elevation_rad = 0;  ///< RecordedLidar::elevation_rad of the first
  /// Its standard deviation; nothing: not estimated or unobservable, the initial value is kept.
  std::optional<double> lidar_elevation_sigma_rad;
  BundleResult bundle;
  /// Scores of the LiDAR's depth edges by camera; empty without images or LiDAR.
  std::vector<std::optional<EdgeScore>> initial_edges, aligned_edges;
  /// Sentences for the user, such as: no LiDAR, so the scale is the egomotion's; an unobservable
  /// readout keeps its initial value.
  std::vector<std::string> remarks;
  std::vector<Finding> damaged;  ///< images and scans that could not be read; remarks in the end
  /// Registration with the ground truth, where the recording ships it.
  std::optional<TrajectoryRegistration> initial_vs_ground_truth, aligned_vs_ground_truth;
  double seconds = 0;
};

/// Aligns a drive, in windows where it is longer than one (align_in_windows), or as a whole.
/// Throws InsufficientDataError with reason and figures where images and LiDAR do not determine the
/// poses: too few observations, no motion, observations that contradict each other, or corrections
/// larger than the errors of an egomotion. InputError as find_tracks and load_lidar_returns.
AlignResult align(const Recording& recording, const AlignOptions& options, ThreadPool& pool);

/// As align, all frames in one bundle adjustment. `tracks`: nullptr, or receives the tracks.
AlignResult align_whole(const Recording& recording, const AlignOptions& options, ThreadPool& pool,
                        std::vector<Track>* tracks = nullptr);

/// Returns all LiDAR samples that `options` allows to use. `damaged`: null, or receives a finding
/// about scans that could not be read.
std::vector<LidarSample> load_align_samples(const Recording& recording, const AlignOptions& options,
                                            ThreadPool& pool,
                                            std::vector<Finding>* damaged = nullptr);

/// Maximum number of LiDAR samples in which planes are searched.
inline constexpr std::size_t kMaxPlaneSamples = 800'000;

/// Returns the recording with aligned poses and calibrations.
Recording with_alignment(Recording recording, const AlignResult& result);

/// Registers the initial poses and the poses of `result` with the ground truth, where the recording
/// ships it.
void register_with_ground_truth(const Recording& recording, AlignResult* result);

/// Aligns from tracks and LiDAR samples. `contrast`: nullptr where images are not available.
AlignResult align_with(const Recording& recording, const std::vector<Track>& tracks,
                       const std::vector<LidarSample>& lidar, const AlignOptions& options,
                       ThreadPool& pool, const ContrastData* contrast = nullptr);

}  // namespace redrive
