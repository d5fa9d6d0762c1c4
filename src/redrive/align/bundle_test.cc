// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle.h"

#include "redrive/align/synthetic_rig.h"
#include "redrive/eval/align.h"

namespace redrive {
namespace {

using testing::kDegree;
using testing::make_synthetic_rig;
using testing::SyntheticOptions;
using testing::SyntheticRig;

struct Outcome {
  RigModel model;
  BundleResult result;
  Alignment before, after;
};

Outcome adjusted(const SyntheticRig& rig, BundleOptions options = {}) {
  ThreadPool pool(2);
  Outcome out;
  out.model = make_rig_model(rig.recording);
  options.say = true;
  out.result = adjust(&out.model, rig.tracks, rig.lidar, options, pool);
  out.before = align_trajectories(rig.recording.frames, rig.recording.true_frames, "");
  out.after = align_trajectories(out.model.corrected_frames(), rig.recording.true_frames, "");
  std::printf("before %.2f cm %.4f deg, after %.2f cm %.4f deg\n", 100 * out.before.rest_m, out.before.rest_deg, 100 * out.after.rest_m, out.after.rest_deg);
  for (std::size_t c = 0; c < rig.true_cameras.size(); ++c) {
    const CameraCalibration now = out.model.corrected_calibration(c);
    const Rigid3d rest = rig.true_cameras[c].body_from_sensor.inverse() * now.body_from_sensor;
    const Eigen::Vector3d turn = so3_log(rest.linear()) / kDegree;
    std::printf("camera %zu: turn %.4f %.4f %.4f deg, shift %.2f %.2f %.2f cm, offset %.2f ms (true %.2f); px %.3f -> %.3f\n", c, turn.x(), turn.y(), turn.z(),
      100*rest.translation().x(), 100*rest.translation().y(), 100*rest.translation().z(), now.time_offset_ns*1e-6, rig.true_cameras[c].time_offset_ns*1e-6, out.result.cameras[c].before_px, out.result.cameras[c].after_px);
  }
  std::printf("lidar %.2f -> %.2f cm\n", 100*out.result.lidar_before_m, 100*out.result.lidar_after_m);
  return out;
}

TEST(Bundle, All) { adjusted(make_synthetic_rig()); }
TEST(Bundle, ImagesAlone) { adjusted(make_synthetic_rig({.lidar_points = 0})); }
TEST(Bundle, LidarAlone) { adjusted(make_synthetic_rig({.points = 0})); }
TEST(Bundle, FarOff) { adjusted(make_synthetic_rig({.pose_noise_m = 0.5, .pose_noise_rad = kDegree})); }
TEST(Bundle, NoNoise) { adjusted(make_synthetic_rig({.noise_px = 0.001, .noise_m = 0})); }

}  // namespace
}  // namespace redrive
