// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/preflight/drive_checks.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/scene/lidar/lidar_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

/// One camera that looks along z from the origin, at frames 0.1 s apart.
Scene one_camera(int frames) {
  Scene scene;
  Camera camera;
  camera.fx = camera.fy = 100;
  camera.cx = camera.cy = 49.5;
  camera.width = camera.height = 100;
  scene.rig.push_back({"CAM", camera, camera, Rigid3d::Identity()});
  for (int f = 0; f < frames; ++f) {
    scene.add_frame({f, f * 100'000'000ll, Rigid3d(Eigen::Translation3d(0, 0, 10.0 * f))});
    scene.views.push_back({0, f});
  }
  return scene;
}

TEST(DriveChecks, ReturnsAreSoughtInTheViewNearestInTime) {
  const Scene scene = one_camera(3);
  EXPECT_EQ(check_lidar_in_images(scene, {}).verdict, Verdict::kCannotTell);
  const auto check = [&](const std::vector<MeasuredPoint>& points) {
    return check_lidar_in_images(scene, returns_of(scene, points));
  };
  const auto ahead = check({{{0, 0, 5}, 40'000'000},
                            {{9, 0, 5}, 0},
                            {{0, 0, 5}, 60'000'000},
                            {{1, 0, 25}, 900'000'000}});
  EXPECT_EQ(ahead.verdict, Verdict::kGood);
  EXPECT_EQ(ahead.why, "50 % of the returns lie in an image") << "the third is behind frame 1";
  const auto behind = check({{{0, 0, -5}, 0}, {{0, 9, 5}, 0}});
  EXPECT_EQ(behind.verdict, Verdict::kWrong);
  EXPECT_THAT(behind.why, HasSubstr("0 of 2 returns lie in an image"));
}

TEST(DriveChecks, NamesBlackImages) {
  RigImages images;
  images.scene = one_camera(4);
  images.grey.resize(1);
  for (const int brightness : {90, 0, 0}) images.grey[0].emplace_back(8, 8, CV_8U, brightness);
  images.grey[0].emplace_back();  // no image
  const std::vector<Finding> findings = find_black_images(images);
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].what, "2 images black: frames 1, 2");
  EXPECT_TRUE(is_black({2, 1, std::vector<std::uint8_t>(6, 1)}));
  EXPECT_FALSE(is_black({2, 1, {0, 0, 0, 0, 0, 9}}));
}

TEST(DriveChecks, FocalLengthOfExifContradictsTheCalibration) {
  const TemporaryFolder folder;
  // 26 mm of a lens on film, in an image of 40 x 30: 30 px.
  const std::string tiff(
      "II*\0\x08\0\0\0\x01\0\x69\x87\x04\0\x01\0\0\0\x1a\0\0\0\0\0\0\0"
      "\x01\0\x05\xa4\x03\0\x01\0\0\0\x1a\0\0\0\0\0\0\0",
      44);
  std::string jpeg(
      "\xff\xd8\xff\xe1\0\x34"
      "Exif\0\0",
      12);
  jpeg += tiff;
  jpeg.append("\xff\xc0\0\x0b\x08\0\x1e\0\x28\x01\x01\x11\0", 13);
  write_file(folder.path / "0.jpg", jpeg);
  RecordedCamera camera;
  camera.calibration.name = "CAM";
  camera.calibration.model = "opencv_pinhole";
  camera.calibration.width = 40;
  camera.calibration.height = 30;
  camera.images.push_back({{0, folder.path / "0.jpg"}, {}, false});
  const auto said = [&](double fx) {
    camera.calibration.parameters = {fx, fx, 20, 15, 0, 0, 0, 0, 0};
    return contradicted_focal_length(camera);
  };
  EXPECT_FALSE(said(33));
  ASSERT_TRUE(said(60));
  EXPECT_EQ(
      said(60)->what,
      "its images name a focal length of 26 mm on film, 30 px, and the calibration has 60 px: "
      "another lens, or another size of the images");
  EXPECT_TRUE(said(15));
}

}  // namespace
}  // namespace redrive
