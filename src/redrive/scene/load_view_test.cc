// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/image_io.h"
#include "redrive/scene/load_views.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/image/image_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using testing::HasSubstr;

class LoadViewTest : public ::testing::Test {
 protected:
  TemporaryFolder folder_;
  const std::filesystem::path& root_ = folder_.path;
};

TEST_F(LoadViewTest, SizeMustAgreeWithTheCalibration) {
  const Recording recording = make_test_recording(root_, 1);
  write_image(recording.cameras[1].images[0].path, smooth_image(23, 16));
  const Scene scene = make_scene(recording, {});
  try {
    load_view(scene, scene.views[1]);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(),
                testing::AllOf(HasSubstr("23 x 16"), HasSubstr("24 x 16"), HasSubstr("FRONT")));
  }
}

/// A scene of one 4 x 2 pinhole image.
class OneView : public LoadViewTest {
 protected:
  OneView() {
    const CameraCalibration calibration{
        "CAM", "opencv_pinhole", {4, 4, 1.5, 0.5, 0, 0, 0, 0, 0}, 4, 2};
    scene_.rig = {{"CAM", make_camera(calibration), make_camera(calibration), Rigid3d::Identity()}};
    scene_.views = {{0, 0, root_ / "image.png"}};
    image_ = {4, 2, std::vector<std::uint8_t>(24, 200)};
  }
  Image8 load() {
    write_image(root_ / "image.png", image_);
    return load_view(scene_, scene_.views[0]);
  }
  template <class Error>
  std::string error_message() {
    try {
      load();
    } catch (const Error& error) {
      return error.what();
    }
    ADD_FAILURE() << "not refused";
    return "";
  }
  void halve() {
    scene_.downscale = 2;
    scene_.rig[0].camera = scene_.rig[0].recorded.downscaled(2);
  }
  static std::vector<std::uint8_t> reds(const Image8& image) {
    std::vector<std::uint8_t> reds;
    for (std::size_t i = 0; i < image.rgb.size(); i += 3) reds.push_back(image.rgb[i]);
    return reds;
  }
  Scene scene_;
  Image8 image_;
};

// 200 at opacities 255, 0, 51 (a fifth) and 102 (two fifths).
TEST_F(OneView, CompositesOverTheBackground) {
  image_.alpha = {255, 0, 51, 102, 255, 0, 51, 102};
  scene_.background = Background::kWhite;
  Image8 image = load();
  EXPECT_EQ(reds(image), (std::vector<std::uint8_t>{200, 255, 244, 233, 200, 255, 244, 233}));
  EXPECT_EQ(image.alpha, image_.alpha);
  scene_.background = Background::kBlack;
  image = load();
  EXPECT_EQ(reds(image), (std::vector<std::uint8_t>{200, 0, 40, 80, 200, 0, 40, 80}));
  EXPECT_EQ(image.alpha, image_.alpha);
}

// Means of composited colours: a transparent pixel's own colour has no weight.
TEST_F(OneView, DownscalesCompositedColoursAndAlpha) {
  image_.alpha = {255, 0, 51, 102, 255, 0, 51, 102};
  for (const int i : {1, 5}) image_.rgb[3 * i] = 10;
  halve();
  scene_.background = Background::kWhite;
  EXPECT_EQ(reds(load()), (std::vector<std::uint8_t>{228, 239}));  // 227.5, 238.5
  scene_.background = Background::kBlack;
  const Image8 image = load();
  EXPECT_EQ(reds(image), (std::vector<std::uint8_t>{100, 60}));
  EXPECT_EQ(image.alpha, (std::vector<std::uint8_t>{128, 77}));  // 127.5, 76.5
}

TEST_F(OneView, TransparencyNeedsABackgroundAndViceVersa) {
  image_.alpha.assign(8, 255);
  EXPECT_TRUE(load().alpha.empty()) << "an opaque alpha channel is dropped";
  image_.alpha[5] = 254;
  EXPECT_THAT(error_message<UsageError>(),
              testing::AllOf(HasSubstr("--background"), HasSubstr("image.png")));
  image_.alpha.clear();
  scene_.background = Background::kBlack;
  EXPECT_THAT(error_message<UsageError>(),
              testing::AllOf(HasSubstr("--background"), HasSubstr("alpha")));
}

TEST_F(OneView, ReadsMasksOfEitherPolarity) {
  EXPECT_TRUE(load().used.empty());
  Image8 mask{4, 2, std::vector<std::uint8_t>(24, 0)};
  for (const int i : {1, 4}) mask.rgb[3 * i + 2] = 1;  // barely not black
  write_image(root_ / "mask.png", mask);
  scene_.views[0].mask = {root_ / "mask.png", true};
  EXPECT_EQ(load().used, (std::vector<std::uint8_t>{0, 255, 0, 0, 255, 0, 0, 0}));
  scene_.views[0].mask.black_is_masked = false;
  EXPECT_EQ(load().used, (std::vector<std::uint8_t>{255, 0, 255, 255, 0, 255, 255, 255}));
  halve();
  EXPECT_EQ(load().used, (std::vector<std::uint8_t>{0, 255}))
      << "a pixel that is masked in part is masked";
}

TEST_F(OneView, RejectsMasksOfAnotherSize) {
  write_image(root_ / "mask.png", Image8{4, 3, std::vector<std::uint8_t>(36, 255)});
  scene_.views[0].mask = {root_ / "mask.png", true};
  EXPECT_THAT(error_message<InputError>(),
              testing::AllOf(HasSubstr("mask.png"), HasSubstr("4 x 3"), HasSubstr("4 x 2")));
}

TEST_F(LoadViewTest, LoadsTheFileUnchanged) {
  const Scene scene = make_scene(make_test_recording(root_, 2), {});
  const Image8 image = load_view(scene, scene.views[3]);
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < 24; ++x) {
      const auto colour = test_colour(1, 1, x, y);
      for (int k = 0; k < 3; ++k) ASSERT_EQ(image.rgb[3 * (24 * y + x) + k], colour[k]);
    }
}

TEST_F(LoadViewTest, DownscaledPixelsAreMeansOfBlocks) {
  SceneOptions options;
  options.downscale = 3;
  const Scene scene = make_scene(make_test_recording(root_, 1), options);
  const Image8 image = load_view(scene, scene.views[1]);
  ASSERT_EQ(image.width, 8);
  ASSERT_EQ(image.height, 5);  // the sixteenth row is left out
  for (int y = 0; y < 5; ++y)
    for (int x = 0; x < 8; ++x) {  // linear in x and y: the mean is the middle one
      const auto colour = test_colour(1, 0, 3 * x + 1, 3 * y + 1);
      for (int k = 0; k < 3; ++k)
        ASSERT_EQ(image.rgb[3 * (8 * y + x) + k], colour[k]) << x << ' ' << y;
    }
}

TEST_F(LoadViewTest, UndistortsAsOpenCvDoes) {
  SceneOptions options;
  options.undistort = true;
  options.cameras = {"FRONT"};
  const Scene scene = make_scene(make_test_recording(root_, 1), options);
  const Image8 ours = load_view(scene, scene.views[0]);
  Image8 recorded = read_image(scene.views[0].image);
  const cv::Mat distorted(16, 24, CV_8UC3, recorded.rgb.data());
  cv::Mat theirs;
  cv::undistort(distorted, theirs, cv::Matx33d(22, 0, 11.5, 0, 20, 7.5, 0, 0, 1),
                cv::Vec<double, 5>(-0.3, 0.08, 0.002, 0.0006, 0));
  int changed = 0;
  for (std::size_t i = 0; i < ours.rgb.size(); ++i) {
    // Maps in 1/32 pixel on both sides, rounded once more here: neighbours differ by at most 7
    // levels, so one level.
    ASSERT_NEAR(ours.rgb[i], theirs.data[i], 1) << i;
    changed += ours.rgb[i] != recorded.rgb[i];
  }
  EXPECT_GT(changed, 100);
}

}  // namespace
}  // namespace redrive
