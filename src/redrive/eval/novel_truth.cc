// SPDX-License-Identifier: Apache-2.0
// Truth of novel views: pictures that a recording ships beside novel/<name>/poses.json.
#include "redrive/base/error.h"
#include "redrive/eval/evaluate.h"
#include "redrive/recording/poses_file.h"
#include "redrive/render/view_pose.h"

namespace redrive {
namespace {

std::filesystem::path truth_path(const NovelSet& set, const RequestedView& view) {
  return set.poses_file.parent_path() / view.file;
}

}  // namespace

// A run of some of the cameras is no error of the set: views of the others are not its business.
std::vector<std::size_t> novel_views_with_truth(const Run& run, const NovelSet& set) {
  const PosesFile poses = read_poses(set.poses_file);
  std::vector<std::size_t> views;
  for (std::size_t i = 0; i < poses.views.size(); ++i) {
    const RequestedView& view = poses.views[i];
    if (run.scene.camera_index(view.camera) < 0) continue;
    if (std::filesystem::exists(truth_path(set, view))) views.push_back(i);
  }
  return views;
}

TruthView load_novel_view(const Run& run, const NovelSet& set, std::size_t index) {
  const PosesFile poses = read_poses(set.poses_file);
  REDRIVE_CHECK_OP(index, <, poses.views.size());
  const RequestedView& view = poses.views[index];

  // load_view knows how a run sees an image (size check, undistortion, downscaling): a scene of one picture.
  Scene scene;
  scene.rig = {
      requested_camera(poses, index, set.poses_file,
                       poses.cameras.empty() ? run.scene.rig : poses_rig(poses, run.scene, /*like_run=*/true))};
  scene.frames.push_back(
      {view.frame_id, 0,
       requested_world_from_body(poses, index, set.poses_file, run.recording, run.scene, /*prefer_shift=*/false)});
  scene.views.push_back({0, 0, truth_path(set, view)});
  scene.downscale = run.scene.downscale;
  scene.undistort = run.scene.undistort;
  return {view.file, scene.rig[0].camera, scene.world_from_camera(scene.views[0]), load_view(scene, scene.views[0])};
}

}  // namespace redrive
