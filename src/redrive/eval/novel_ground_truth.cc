// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/novel_ground_truth.h"

#include "redrive/base/error.h"
#include "redrive/render/view_pose.h"
#include "redrive/scene/load_views.h"

namespace redrive {

Rigid3d world_from_ground_truth(const Run& run, const TrajectoryRegistration& alignment) {
  return run.scene.global_from_world.inverse(Eigen::Isometry) * alignment.run_from_ground_truth;
}

NovelGroundTruth::NovelGroundTruth(const Run& run, const NovelSet& set,
                                   const TrajectoryRegistration& alignment)
    : run_(run),
      name_(set.name),
      poses_(read_view_requests(set.poses_file)),
      rig_(poses_rig(poses_, run.scene, /*like_run=*/true)),
      world_from_ground_truth_(world_from_ground_truth(run, alignment)) {
  // The run may have trained only some of the cameras: skips views of the others.
  for (std::size_t i = 0; i < poses_.views.size(); ++i)
    if (run.scene.camera_index(poses_.views[i].camera) >= 0 &&
        std::filesystem::exists(poses_.path.parent_path() / poses_.views[i].file))
      views_.push_back(i);
}

const RigCamera& NovelGroundTruth::camera(std::size_t index) const {
  return requested_camera(poses_, views_.at(index), rig_);
}

GroundTruthView NovelGroundTruth::load(std::size_t index) const {
  REDRIVE_CHECK_OP(index, <, views_.size());
  const RequestedView& view = poses_.views[views_[index]];
  const std::filesystem::path image = poses_.path.parent_path() / view.file;

  // load_view checks the size, undistorts and downscales as the run does: makes a scene of one
  // image.
  Scene scene;
  const RigCamera& camera = this->camera(index);
  scene.rig = {camera};
  scene.downscale = run_.scene.downscale;
  scene.undistort = run_.scene.undistort && camera.recorded.info().perspective;
  scene.background = run_.scene.background;
  scene.views = {{0, 0, image}};
  const Rigid3d world_from_body =
      view.global_from_body
          ? world_from_ground_truth_ * *view.global_from_body
          : requested_world_from_body(poses_, views_[index], camera, run_.scene, false);
  const Rigid3d world_from_camera = world_from_body * camera.body_from_sensor;
  GroundTruthView ground_truth{view.file,
                               camera.camera,
                               world_from_camera,
                               posed_at_frame(run_.scene, camera, world_from_camera, view.frame_id),
                               exposure_at(run_.scene, camera.name, view.frame_id),
                               load_view(scene, scene.views[0]),
                               {}};
  const std::filesystem::path depth = image.parent_path() / (image.stem().string() + "_depth.png");
  if (std::filesystem::exists(depth)) ground_truth.depth_m = load_depth(depth, camera);
  return ground_truth;
}

std::optional<TrajectoryRegistration> register_with_ground_truth(const Run& run) {
  if (run.recording.ground_truth_frames.empty()) return std::nullopt;
  std::vector<FramePose> used;
  for (const FramePose& frame : run.scene.corrected_trajectory())
    if (run.scene.frame_index(frame.id) >= 0) used.push_back(frame);
  return register_trajectories(used, run.recording.ground_truth_frames, run.recording.root);
}

std::vector<NovelGroundTruth> novel_ground_truths(const Run& run) {
  const TrajectoryRegistration alignment =
      register_with_ground_truth(run).value_or(TrajectoryRegistration{});
  std::vector<NovelGroundTruth> ground_truths;
  for (const NovelSet& set : run.recording.novel)
    if (NovelGroundTruth ground_truth(run, set, alignment); ground_truth.size() > 0)
      ground_truths.push_back(std::move(ground_truth));
  return ground_truths;
}

}  // namespace redrive
