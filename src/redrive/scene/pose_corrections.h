// SPDX-License-Identifier: Apache-2.0
// Small corrections of the initial poses: the body's at each frame, each camera's extrinsics and
// time offset. Training refines poses by them (train/pose_refiner.h); a checkpoint holds them.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "redrive/scene/scene.h"

namespace redrive {

struct PoseCorrections {
  int frames = 0, cameras = 0;  ///< numbers of frames and cameras of the scene
  /// [frames, 6] in the body's axes, [cameras, 6] in the camera's, each a translation (m) and a
  /// rotation vector (rad), then [cameras] seconds by which images are exposed later. Empty: no
  /// corrections.
  std::vector<float> values;

  PoseCorrections() = default;
  explicit PoseCorrections(const Scene& scene)
      : frames(static_cast<int>(scene.frames.size())),
        cameras(static_cast<int>(scene.rig.size())),
        values(size()) {}

  std::size_t size() const {
    return 6 * static_cast<std::size_t>(frames + cameras) + static_cast<std::size_t>(cameras);
  }
  std::size_t frame_slot(int frame) const { return 6 * static_cast<std::size_t>(frame); }
  std::size_t camera_slot(int camera) const { return frame_slot(frames + camera); }
  std::size_t time_slot(int camera) const {
    return frame_slot(frames + cameras) + static_cast<std::size_t>(camera);
  }
};

/// The motion of a Vector6d (math/so3.h) in single precision.
Rigid3d rigid_from_vector(const float* six);

/// Interpolates the corrections of frames without a training image by time between the frames
/// before and after that have one; beyond the ends the nearest one's.
void interpolate_held_out(const Scene& scene, PoseCorrections* corrections);

/// Sets the poses of frames, rig and views of `*corrected`, a copy of `initial`, to the poses of
/// `initial` with the corrections. `trajectory`: trajectory of the recording that the scene was
/// made from; returned with the corrections, in the same frame of reference (global_from_body). A
/// pose at none of the scene's frames is corrected by the interpolated corrections of the frames
/// around it.
std::vector<FramePose> apply_corrections(const Scene& initial,
                                         const std::vector<FramePose>& trajectory,
                                         const PoseCorrections& corrections, Scene* corrected);

/// Gradient of the loss with respect to one view's pose, in the world: translating its camera by v
/// and rotating it by w (rad) raises the loss by d_translation v + d_rotation w.
struct ViewGradient {
  Eigen::Vector3d d_translation = Eigen::Vector3d::Zero(), d_rotation = Eigen::Vector3d::Zero();
};
/// Returns the gradient with respect to the six numbers (rigid_from_vector) of the body that
/// carries the camera.
Vector6d in_body(const Scene& scene, const View& view, const ViewGradient& gradient);
/// Converts the scene's gradients of views to gradients of corrections, at 0 or at the corrections
/// of `scene`. A view between two frames (with a time offset) depends on both.
std::vector<double> gradient_of_corrections(const Scene& scene, const PoseCorrections& corrections,
                                            std::span<const ViewGradient> views);

}  // namespace redrive
