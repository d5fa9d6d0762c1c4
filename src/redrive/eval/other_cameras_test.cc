// SPDX-License-Identifier: Apache-2.0
// A run that was trained on one of two cameras, whose rendered image is a formula.
#include "redrive/eval/other_cameras.h"

#include <nlohmann/json.hpp>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

class OtherCameras : public ::testing::Test {
 protected:
  OtherCameras() {
    run_.recording = make_test_recording(folder_.path);
    run_.options.cameras = {"FRONT"};
    run_.options.masks = "none";
    run_.scene = make_scene(run_.recording, scene_options(run_.options));
    run_.state.model = make_painted_model();
  }
  TemporaryFolder folder_;
  redrive::Run run_;
};

TEST_F(OtherCameras, AreScoredAfterGainsOfTheirChannels) {
  for (const ImageFile& image : run_.recording.find_camera("FISHEYE")->images) {
    Image8 grey{20, 14, {}};
    for (int i = 0; i < 20 * 14; ++i) grey.rgb.insert(grey.rgb.end(), {102, 51, 153});
    write_image(image.path, grey);
  }
  PaintBackend paint([](const auto&, const auto&) {
    return std::array<float, 3>{0.2f, 0.4f, 0.6f};
  });
  EvalOptions options;
  options.max_images = 2;
  const auto scores = score_other_cameras(run_, paint, {"FISHEYE"}, options);
  ASSERT_EQ(scores.size(), 1u);
  const OtherCameraScore& other = scores.at("FISHEYE");
  EXPECT_EQ(other.score.images, 2);
  // 1e-6: rounding of floats.
  EXPECT_NEAR(other.gains[0], 2, 1e-6);
  EXPECT_NEAR(other.gains[1], 0.5, 1e-6);
  EXPECT_NEAR(other.gains[2], 1, 1e-6);
  EXPECT_EQ(other.score.psnr_db, kPsnrCapDb);
  EXPECT_FALSE(other.view_alignment);
  EXPECT_EQ(other_cameras_to_json(scores)["other_cameras"]["FISHEYE"]["images"], 2);
}

// Corrections of the trained camera's extrinsics hold for the other one, too.
TEST_F(OtherCameras, AreMountedToTheTrainedCamera) {
  const Rigid3d correction(Eigen::Translation3d(0.25, -0.5, 0.125));
  run_.scene.rig[0].body_from_sensor = correction * run_.scene.rig[0].body_from_sensor;
  std::array<float, 3> seen{};
  PaintBackend paint([&](const auto& origin, const auto&) {
    seen = origin;
    return std::array<float, 3>{0.5f, 0.5f, 0.5f};
  });
  EvalOptions options;
  options.max_images = 1;  // the middle one: frame 3
  score_other_cameras(run_, paint, {"FISHEYE"}, options);
  const Eigen::Vector3d expected =
      run_.scene.world_from_body(run_.scene.frames[3].t_ns) * correction *
      run_.recording.find_camera("FISHEYE")->calibration.body_from_sensor.translation();
  for (int k = 0; k < 3; ++k) EXPECT_NEAR(seen[k], expected[k], 1e-5) << k;
}

TEST_F(OtherCameras, RejectsCamerasThatWereTrainedOnOrAreMissing) {
  PaintBackend paint([](const auto&, const auto&) { return std::array<float, 3>{}; });
  EXPECT_THROW(score_other_cameras(run_, paint, {"FRONT"}), UsageError);
  EXPECT_THROW(score_other_cameras(run_, paint, {"REAR"}), UsageError);
}

}  // namespace
}  // namespace redrive
