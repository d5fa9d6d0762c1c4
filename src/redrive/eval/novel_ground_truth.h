// SPDX-License-Identifier: Apache-2.0
// Ground truth of novel views: images that a recording holds beside novel/<name>/poses.json,
// FILE.jpg and optionally FILE_depth.png (scene/load_views.h: load_depth).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "redrive/edit/view_requests.h"
#include "redrive/recording/core/register_trajectories.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/run.h"

namespace redrive {

/// Ground truth of one novel view, undistorted and downscaled as the run's training images, with
/// its camera and pose.
struct GroundTruthView {
  std::string name;  ///< file of the novel set
  Camera camera;
  Rigid3d world_from_camera;
  ShutterPoses poses;  ///< world_from_camera with the moving objects of its frame
  Exposure exposure;
  Image8 image;
  std::vector<float>
      depth_m;  ///< [height, width] along the ray, 0 where unknown; empty without FILE_depth.png
};

/// Returns the run's world from the global frame of ground-truth poses.
Rigid3d world_from_ground_truth(const Run& run, const TrajectoryRegistration& alignment);

/// The views of one novel set with ground truth, from cameras that the run trained.
class NovelGroundTruth {
 public:
  /// Throws InputError if poses.json is malformed.
  NovelGroundTruth(const Run& run, const NovelSet& set, const TrajectoryRegistration& alignment);

  const std::string& name() const { return name_; }  ///< name of the set
  std::size_t size() const { return views_.size(); }
  const std::filesystem::path& poses_file() const { return poses_.path; }
  const RequestedView& request(std::size_t index) const {
    return poses_.views.at(views_.at(index));
  }
  const RigCamera& camera(std::size_t index) const;  ///< camera of a view, like the run's
  /// Loads a view. A pose in ECEF is a ground-truth pose and is transformed by the alignment; a
  /// shift is applied to the run's own pose. Throws InputError if the image's size differs from its
  /// calibration.
  GroundTruthView load(std::size_t index) const;

 private:
  const Run& run_;
  std::string name_;
  ViewRequests poses_;
  std::vector<RigCamera> rig_;  ///< cameras of poses_
  Rigid3d world_from_ground_truth_;
  std::vector<std::size_t> views_;  ///< indices into poses_.views
};

/// Registers a run's poses with the ground truth; nothing where the recording has none.
std::optional<TrajectoryRegistration> register_with_ground_truth(const Run& run);

/// Returns the novel sets of the run's recording that have ground truth (size() > 0), registered
/// with the run by register_with_ground_truth.
std::vector<NovelGroundTruth> novel_ground_truths(const Run& run);

}  // namespace redrive
