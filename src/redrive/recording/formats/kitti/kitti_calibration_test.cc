// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_calibration.h"

#include "redrive/recording/formats/kitti/kitti_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;

/// Replaces the numbers of a key, or leaves it out with an empty text.
std::string with_key(std::string text, const std::string& key, const std::string& numbers) {
  const std::size_t begin = text.find(key + ":");
  const std::size_t end = text.find('\n', begin) + 1;
  return text.replace(begin, end - begin, numbers.empty() ? "" : key + ": " + numbers + "\n");
}

TEST(KittiCalibration, ReadsProjections) {
  const kitti::CamToCam calibration =
      kitti::parse_cam_to_cam(testing::kitti_cam_to_cam(), "calib_cam_to_cam.txt");
  EXPECT_TRUE(calibration.rectified_from_camera.isApprox(Rigid3d::Identity()));
  ASSERT_EQ(calibration.cameras.size(), 2u);
  const kitti::RectifiedCamera& camera = calibration.cameras.at(2);
  EXPECT_EQ(camera.fx, 720);
  EXPECT_EQ(camera.fy, 720);
  EXPECT_EQ(camera.cx, 600);
  EXPECT_EQ(camera.cy, 180);
  ASSERT_TRUE(camera.size);
  EXPECT_EQ(camera.size->width, 1242);
  EXPECT_EQ(camera.size->height, 375);
  EXPECT_NEAR(camera.camera_from_rectified.translation().x(), 43.2 / 720, 1e-15);
}

// P (x, 1) = K (x + t), for a fourth column with all its components.
TEST(KittiCalibration, FourthColumnIsTheBaseline) {
  const auto calibration = kitti::parse_odometry_calibration(
      "P1: 700 0 600 -380 0 710 180 2.2 0 0 1 0.003\n", "calib.txt");
  const kitti::RectifiedCamera& camera = calibration.cameras.at(1);
  EXPECT_FALSE(camera.size);
  EXPECT_FALSE(calibration.rectified_from_velodyne);
  const Eigen::Vector3d x(3, -2, 15);
  Eigen::Matrix<double, 3, 4> projection;
  projection << 700, 0, 600, -380, 0, 710, 180, 2.2, 0, 0, 1, 0.003;
  const Eigen::Vector3d expected = projection * x.homogeneous(),
                        in_camera = camera.camera_from_rectified * x;
  EXPECT_NEAR(camera.fx * in_camera.x() / in_camera.z() + camera.cx, expected.x() / expected.z(),
              1e-9);
  EXPECT_NEAR(camera.fy * in_camera.y() / in_camera.z() + camera.cy, expected.y() / expected.z(),
              1e-9);
}

TEST(KittiCalibration, ReadsRigidTransforms) {
  const Rigid3d camera_from_velodyne =
      kitti::parse_rigid(testing::kitti_velo_to_cam(), "calib_velo_to_cam.txt");
  EXPECT_TRUE((camera_from_velodyne * Eigen::Vector3d(10, 1, 2))
                  .isApprox(Eigen::Vector3d(-1, -2.08, 9.75), 1e-15));
  const auto calibration =
      kitti::parse_odometry_calibration("Tr: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.25\n", "calib.txt");
  ASSERT_TRUE(calibration.rectified_from_velodyne);
  EXPECT_TRUE(calibration.rectified_from_velodyne->isApprox(camera_from_velodyne, 1e-15));
}

TEST(KittiCalibration, RejectsInvalidValues) {
  const std::string whole = testing::kitti_cam_to_cam();
  const auto message = [&](const std::string& key, const std::string& numbers) {
    const std::string message = input_error([&] {
      kitti::parse_cam_to_cam(with_key(whole, key, numbers), "day/calib_cam_to_cam.txt");
    });
    EXPECT_THAT(message, HasSubstr("day/calib_cam_to_cam.txt: " + key));
    return message;
  };
  EXPECT_THAT(message("R_rect_00", ""), HasSubstr("missing"));
  EXPECT_THAT(message("S_rect_02", ""), HasSubstr("missing"));
  EXPECT_THAT(message("R_rect_00", "1 0 0 0 1 0 0 0"), HasSubstr("9 numbers"));
  EXPECT_THAT(message("R_rect_00", "1 0 0 0 1 0 0 0 -1"), HasSubstr("reflection"));
  EXPECT_THAT(message("R_rect_00", "1 0 0 0 1 0 0 0 2"), HasSubstr("R_rect_00"));
  EXPECT_THAT(message("P_rect_02", "720 0 600 43 0 720 180 0 0 0 1"), HasSubstr("12 numbers"));
  EXPECT_THAT(message("P_rect_02", "nan 0 600 43 0 720 180 0 0 0 1 0"),
              AllOf(HasSubstr("P_rect_02[0]"), HasSubstr("nan")));
  EXPECT_THAT(message("P_rect_02", "-720 0 600 43 0 720 180 0 0 0 1 0"),
              AllOf(HasSubstr("P_rect_02[0] = -720"), HasSubstr("focal length")));
  EXPECT_THAT(message("P_rect_02", "720 1 600 43 0 720 180 0 0 0 1 0"), HasSubstr("rectified"));
  EXPECT_THAT(message("P_rect_02", "720 0 600 43 0 720 180 0 0 0 2 0"), HasSubstr("rectified"));
  EXPECT_THAT(message("P_rect_02", "720 0 6000 43 0 720 180 0 0 0 1 0"),
              AllOf(HasSubstr("P_rect_02[2] = 6000"), HasSubstr("principal point")));
  EXPECT_THAT(message("P_rect_02", "720 0 600 43200 0 720 180 0 0 0 1 0"), HasSubstr("50 m"));
  EXPECT_THAT(message("S_rect_02", "1242.5 375"), HasSubstr("S_rect_02[0] = 1242.5"));
  EXPECT_THAT(message("S_rect_02", "1242 0"), HasSubstr("S_rect_02[1] = 0"));
  EXPECT_THAT(message("S_rect_02", "1242 375 3"), HasSubstr("2 numbers"));
  const auto rigid = [](const std::string& text) {
    return input_error([&] { kitti::parse_rigid(text, "calib_velo_to_cam.txt"); });
  };
  EXPECT_THAT(rigid(""), HasSubstr("calib_velo_to_cam.txt: R: missing"));
  EXPECT_THAT(rigid("R: 1 0 0 0 1 0 0 0 1\n"), HasSubstr("T: missing"));
  EXPECT_THAT(rigid("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 60\n"), HasSubstr("50 m"));
  EXPECT_THAT(rigid("R: 1 0 0 0 1 0 0 0 1\nR: 1\n"),
              AllOf(HasSubstr("line 2, key = R:"), HasSubstr("earlier line")));
  EXPECT_THAT(rigid("R 1 0 0 0 1 0 0 0 1\n"), HasSubstr("line 1, key = R: expected \"KEY:"));
  EXPECT_THAT(input_error([] { kitti::parse_odometry_calibration("Tr: 1 0 0\n", "calib.txt"); }),
              HasSubstr("calib.txt: Tr"));
}

}  // namespace
}  // namespace redrive
