// SPDX-License-Identifier: Apache-2.0
// Summary of the pose corrections of training: printed after training, drawn in the report, written
// by eval.
#pragma once

#include <string>
#include <vector>

#include "redrive/scene/pose_corrections.h"
#include "redrive/train/poses/pose_refinement.h"

namespace redrive {

struct PoseChange {
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero(),
                  rotation_rad = Eigen::Vector3d::Zero();  ///< axes of the body
  bool at_bound = false;  ///< one of its values is at its bound, for cameras also the time offset
};
struct CameraChange {
  std::string name;
  PoseChange pose;           ///< change of the extrinsics
  double time_offset_s = 0;  ///< change of exposure time
};

struct PoseChanges {
  std::vector<PoseChange> frames;              ///< as Scene::frames
  std::vector<CameraChange> cameras;           ///< as Scene::rig
  double translation_m = 0, rotation_rad = 0;  ///< RMS over frames
  PoseBounds bounds;
  int frames_at_bound() const;
};

/// Summarises corrections and tells which are at their bounds. `scene`: with them applied
/// (open_run). A value within 2 % of its bound counts as at its bound, since noise keeps it from
/// reaching the bound exactly.
PoseChanges pose_changes(const Scene& scene, const PoseCorrections& corrections,
                         const PoseBounds& bounds);

/// Returns a line for the trajectory and one for each camera, in cm, degrees and ms, with a warning
/// where a value is at its bound.
std::string describe_changes(const PoseChanges& changes);
/// Returns the frames and cameras at their bounds: "3 of 30 frames, F_CAM"; empty if none are.
std::string at_bound(const PoseChanges& changes);

}  // namespace redrive
