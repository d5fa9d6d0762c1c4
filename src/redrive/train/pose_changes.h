// SPDX-License-Identifier: Apache-2.0
// What refined poses come to, to be read: printed after training, drawn in the report, written by
// eval.
#pragma once

#include <string>
#include <vector>

#include "redrive/scene/pose_corrections.h"

namespace redrive {

struct PoseChange {
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero(),
                  rotation_rad = Eigen::Vector3d::Zero();  ///< axes of the body
  bool at_bound = false;  ///< one of its numbers, of a camera its time, too
};
struct CameraChange {
  std::string name;
  PoseChange pose;           ///< on the body
  double time_offset_s = 0;  ///< images are exposed so much later
};

struct PoseChanges {
  std::vector<PoseChange> frames;              ///< as Scene::frames
  std::vector<CameraChange> cameras;           ///< as Scene::rig
  double translation_m = 0, rotation_rad = 0;  ///< of frames, RMS of their lengths
  int frames_at_bound() const;
};

/// `scene`: as the corrections place it (open_run); as recorded, axes in which cameras have moved
/// are turned by what they have turned. At its bound (train/pose_refiner.h) is what has come within
/// a fiftieth of it: noise keeps it from standing there exactly.
PoseChanges pose_changes(const Scene& scene, const PoseCorrections& corrections);

/// A line for the trajectory and one for each camera, in cm, degrees and ms, with a warning where a
/// number is at its bound.
std::string describe_changes(const PoseChanges& changes);
/// "3 of 30 frames, F_CAM": what is at its bound; empty: nothing.
std::string at_bound(const PoseChanges& changes);

}  // namespace redrive
