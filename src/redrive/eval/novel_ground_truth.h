// SPDX-License-Identifier: Apache-2.0
// Truth of views that were never driven: pictures that a recording ships beside
// novel/<name>/poses.json, FILE.jpg and, where it is known, FILE_depth.png (scene/load_views.h:
// load_depth).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "redrive/recording/register_trajectories.h"
#include "redrive/recording/view_requests.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/run.h"

namespace redrive {

/// A picture to score: truth as a run trains on it (undistorted, downscaled) and where it was taken
/// from.
struct GroundTruthView {
  std::string name;  ///< file of the novel set
  Camera camera;
  Rigid3d world_from_camera;
  Exposure exposure;
  Image8 truth;
  std::vector<float>
      depth_m;  ///< [height, width] along the ray, 0 where it is not known; empty if no depth ships
};

/// The views of one novel set whose truth is there, of cameras that the run trained.
class NovelGroundTruth {
 public:
  /// InputError: poses.json cannot be used.
  NovelGroundTruth(const Run& run, const NovelSet& set, const TrajectoryRegistration& alignment);

  const std::string& name() const { return name_; }  ///< of the set
  std::size_t size() const { return views_.size(); }
  /// Places that the set gives in ECEF are the true ones and go through the alignment; those it
  /// gives as a shift move the run's own pose. InputError: truth that has not the size that its
  /// calibration says.
  GroundTruthView load(std::size_t index) const;

 private:
  const Run& run_;
  std::string name_;
  ViewRequests poses_;
  std::vector<RigCamera> rig_;  ///< of poses_
  Rigid3d ground_truth_global_from_world_;
  std::vector<std::size_t> views_;  ///< indices into poses_.views
};

/// The alignment of a run's poses with the true ones; nothing where the recording ships none.
std::optional<TrajectoryRegistration> register_with_ground_truth(const Run& run);

/// The novel sets of the run's recording that have truth (size() > 0), laid over the run by
/// register_with_ground_truth.
std::vector<NovelGroundTruth> novel_ground_truths(const Run& run);

}  // namespace redrive
