// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/novel_truth.h"

#include <cmath>

#include "redrive/base/error.h"
#include "redrive/render/view_pose.h"

namespace redrive {
namespace {

constexpr std::uint16_t kNoDepth = 0, kBeyondDepth = 65535;

std::string size_text(int width, int height) { return std::to_string(width) + " x " + std::to_string(height); }

/// Depth as `camera` sees it, from that of the recorded image: the nearest pixel's, since depths do not mix.
std::vector<float> load_depth(const std::filesystem::path& path, const RigCamera& rig) {
  int width = 0, height = 0;
  const std::vector<std::uint16_t> depth_mm = read_png16(path, &width, &height);
  if (width != rig.recorded.width || height != rig.recorded.height)
    throw InputError(path, "size", size_text(width, height),
                     "the calibration of " + rig.name + " says " + size_text(rig.recorded.width, rig.recorded.height));
  const Camera& camera = rig.camera;
  std::vector<float> depth_m(static_cast<std::size_t>(camera.width) * camera.height, 0.0f);
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const auto direction = camera.unproject({x, y});
      const auto recorded = direction ? rig.recorded.project(*direction) : std::nullopt;
      if (!recorded) continue;
      const long u = std::lround(recorded->x()), v = std::lround(recorded->y());
      if (u < 0 || v < 0 || u >= width || v >= height) continue;
      const std::uint16_t value = depth_mm[static_cast<std::size_t>(v) * width + u];
      if (value != kNoDepth && value != kBeyondDepth)
        depth_m[static_cast<std::size_t>(y) * camera.width + x] = 0.001f * value;
    }
  return depth_m;
}

}  // namespace

NovelTruth::NovelTruth(const Run& run, const NovelSet& set, const Alignment& alignment)
    : run_(run),
      file_(set.poses_file),
      poses_(read_poses(set.poses_file)),
      true_ecef_from_world_(alignment.run_from_true.inverse(Eigen::Isometry) * run.scene.ecef_from_world) {
  // A run of some of the cameras is no error of the set: views of the others are not its business.
  for (std::size_t i = 0; i < poses_.views.size(); ++i)
    if (run.scene.camera_index(poses_.views[i].camera) >= 0 &&
        std::filesystem::exists(file_.parent_path() / poses_.views[i].file))
      views_.push_back(i);
}

TruthView NovelTruth::load(std::size_t index) const {
  REDRIVE_CHECK_OP(index, <, views_.size());
  const RequestedView& view = poses_.views[views_[index]];
  const std::filesystem::path image = file_.parent_path() / view.file;

  // load_view knows how a run sees an image (size check, undistortion, downscaling): a scene of one picture.
  Scene scene;
  scene.rig = {
      requested_camera(poses_, views_[index], file_,
                       poses_.cameras.empty() ? run_.scene.rig : poses_rig(poses_, run_.scene, /*like_run=*/true))};
  scene.downscale = run_.scene.downscale;
  scene.undistort = run_.scene.undistort;
  scene.views = {{0, 0, image, false,
                  view.ecef_from_body
                      ? true_ecef_from_world_.inverse(Eigen::Isometry) * *view.ecef_from_body
                      : requested_world_from_body(poses_, views_[index], file_, run_.recording, run_.scene, false)}};
  TruthView truth{
      view.file, scene.rig[0].camera, scene.world_from_camera(scene.views[0]), load_view(scene, scene.views[0]), {}};
  const std::filesystem::path depth = image.parent_path() / (image.stem().string() + "_depth.png");
  if (std::filesystem::exists(depth)) truth.depth_m = load_depth(depth, scene.rig[0]);
  return truth;
}

}  // namespace redrive
