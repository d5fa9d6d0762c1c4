// SPDX-License-Identifier: Apache-2.0
// CameraInfo of whole, cut, binned, scaled and rectified images.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/camera/camera.h"
#include "redrive/recording/formats/rosbag/rig.h"

namespace redrive::rosbag {
namespace {

using ::testing::HasSubstr;

CameraInfo info() {
  CameraInfo out;
  out.width = 1600;
  out.height = 1200;
  out.model = "plumb_bob";
  out.d = {-0.2, 0.03, 0.001, -0.002, 0.01};
  out.k = {900, 0, 803, 0, 905, 611, 0, 0, 1};
  out.p = {700, 0, 790, 0, 0, 702, 600, 0, 0, 0, 1, 0};
  return out;
}

Camera camera_of(const CameraInfo& of, int width, int height, bool rectified = false,
                 std::vector<Finding>* findings = nullptr) {
  CameraTopics topics{.name = "front", .image = "/front/image", .info = "/front/camera_info"};
  topics.rectified = rectified;
  std::vector<Finding> ignored;
  return make_camera(
      calibration_of(topics, of, width, height, "bag", findings ? findings : &ignored));
}

const Eigen::Vector3d kPoints[] = {{0, 0, 1}, {0.3, -0.2, 1}, {-0.5, 0.4, 2}};

// A pixel covers 2 x 4 pixels of the whole image.
TEST(BagCalibration, RegionsAreCutOutThenBinned) {
  CameraInfo cut = info();
  cut.roi_x = 200;
  cut.roi_y = 100;
  cut.roi_width = 1200;
  cut.roi_height = 800;
  cut.binning_x = 2;
  cut.binning_y = 4;
  const Camera whole = camera_of(info(), 1600, 1200), part = camera_of(cut, 600, 200);
  EXPECT_EQ(part.width, 600);
  EXPECT_EQ(part.height, 200);
  for (const Eigen::Vector3d& point : kPoints) {
    const Eigen::Vector2d in_whole = *whole.project(point),
                          expected((in_whole.x() - 200 + 0.5) / 2 - 0.5,
                                   (in_whole.y() - 100 + 0.5) / 4 - 0.5);
    EXPECT_LT((*part.project(point) - expected).norm(), 1e-9);
  }
}

TEST(BagCalibration, RationalPolynomialsMayHaveAPrism) {
  CameraInfo rational = info();
  rational.model = "rational_polynomial";
  rational.d = {0.2, -0.1, 0.001, -0.0005, 0.01, 0.5, -0.08, 0.02};
  EXPECT_EQ(camera_of(rational, 1600, 1200).info().name, std::string("opencv_rational"));
  rational.d.insert(rational.d.end(), {0.001, 0, 0, 0.002, 0, 0});
  EXPECT_EQ(camera_of(rational, 1600, 1200).info().name, std::string("opencv_thin_prism"));
  rational.model = "plumb_bob";  // some drivers say this with all of OpenCV's coefficients
  EXPECT_EQ(camera_of(rational, 1600, 1200).info().name, std::string("opencv_thin_prism"));
  rational.d.back() = 0.1;
  try {
    camera_of(rational, 1600, 1200);
    ADD_FAILURE() << "a tilted sensor";
  } catch (const InputError& error) {
    EXPECT_EQ(error.field, "/front/camera_info d[13]");
  }
}

TEST(BagCalibration, RectifiedImagesHaveTheirProjection) {
  const Camera camera = camera_of(info(), 1600, 1200, /*rectified=*/true);
  for (const Eigen::Vector3d& point : kPoints) {
    const Eigen::Vector2d expected(700 * point.x() / point.z() + 790,
                                   702 * point.y() / point.z() + 600);
    EXPECT_LT((*camera.project(point) - expected).norm(), 1e-9);
  }
}

TEST(BagCalibration, ImagesOfAnotherScale) {
  std::vector<Finding> findings;
  const Camera whole = camera_of(info(), 1600, 1200),
               half = camera_of(info(), 800, 600, false, &findings);
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_THAT(findings[0].what, HasSubstr("scaled: CameraInfo is for 1600 x 1200"));
  for (const Eigen::Vector3d& point : kPoints) {
    const Eigen::Vector2d expected = ((*whole.project(point)).array() + 0.5) / 2 - 0.5;
    EXPECT_LT((*half.project(point) - expected).norm(), 1e-9);
  }
  EXPECT_THROW(camera_of(info(), 800, 500), InputError) << "another aspect";
}

TEST(BagCalibration, GivenIntrinsicsStandInPlaceOfInfo) {
  CameraTopics topics{.name = "front", .image = "/front/image"};
  topics.intrinsics = CameraCalibration{.model = "mei", .width = 1600, .height = 1200};
  topics.intrinsics->parameters = {900, 905, 803, 611, -0.2, 0.03, 0.001, -0.002, 0, 1.1};
  topics.readout_s = 0.02;
  std::vector<Finding> findings;
  const CameraCalibration given = calibration_of(topics, {}, 1600, 1200, "bag", &findings);
  EXPECT_EQ(given.model, "mei");
  EXPECT_EQ(given.parameters, topics.intrinsics->parameters);
  EXPECT_EQ(given.readout_ns, 20'000'000);
  EXPECT_TRUE(findings.empty());
  topics.intrinsics->parameters[0] = -1;
  EXPECT_THROW(calibration_of(topics, {}, 1600, 1200, "bag", &findings), InputError);
}

}  // namespace
}  // namespace redrive::rosbag
