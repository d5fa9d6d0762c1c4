// SPDX-License-Identifier: Apache-2.0
// Joins trajectories of a drive's windows, which overlap, into one. Each window was aligned on its
// own: a rigid motion of the whole window, which only the egomotion measures, differs from window
// to window. These motions are estimated together, from the overlaps and from how precisely the
// egomotion determines each. Over an overlap the joined trajectory passes from one window to the
// next, so that it has no step.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "redrive/align/rigid_motions.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// Frames `begin` to `end` - 1 of a drive, by index.
struct FrameWindow {
  int begin = 0, end = 0;
  int size() const { return end - begin; }
};

/// Windows of equal size (+-1), at most `most` >= 10 frames, each overlapping the next by a fifth
/// of that. A frame is in two at most. One window if there are no more than `most` frames.
std::vector<FrameWindow> cut_windows(int frames, int most);

/// A window's aligned trajectory, and covariances of rigid motions of it, 6: translation (m) and
/// rotation (rad) in the axes of the drive's first frame, about the window's middle (the mean
/// position).
struct WindowTrajectory {
  FrameWindow frames;
  std::vector<FramePose> poses;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  Matrix6d whole = Matrix6d::Zero();  ///< covariance of the mean over the window
  /// Covariance of the mean over the overlap with the previous window, and with the next one,
  /// relative to the mean of the whole; zero where there is none.
  Matrix6d start = Matrix6d::Zero(), end = Matrix6d::Zero();
};

/// Returns a covariance that is at least each of two positive definite ones in every direction:
/// where both are diagonal, the larger numbers. Zero if `a` is.
Matrix6d larger_covariance(const Matrix6d& a, const Matrix6d& b);

/// `covariance`, `robust`: at least [6 n, 6 n] of the poses' errors, in the axes of each body
/// (BundleResult::covariance, robust_covariance); the larger one counts. `overlap_before`,
/// `overlap_after`: frames shared with neighbours. `world_from_global`: to the axes of the drive's
/// first frame.
WindowTrajectory window_trajectory(const FrameWindow& frames, std::vector<FramePose> poses,
                                   const Eigen::MatrixXd& covariance, const Eigen::MatrixXd& robust,
                                   int overlap_before, int overlap_after,
                                   const Rigid3d& world_from_global);

struct JoinedTrajectory {
  std::vector<FramePose> frames;
  /// [6], one per frame: variances that joining adds to the variances of a window's shape, in the
  /// axes of the body, a rigid motion of the whole drive excluded. Windows are joined as if they
  /// were independent; what they share of their frames counts twice then, so variances are
  /// multiplied by how often a frame is in a window on average.
  std::vector<Vector6d> variance;
  double seam_m = 0, seam_rad = 0;  ///< RMS disagreement of neighbours over overlaps after joining
};

/// `windows`: in order, from the drive's first to its last frame, at least one.
JoinedTrajectory join_trajectories(const std::vector<WindowTrajectory>& windows,
                                   const Rigid3d& world_from_global);

}  // namespace redrive
