// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/photographs.h"

#include "redrive/image/image_io.h"
#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using testing::input_error;

TEST(Photographs, FindsImagesByTheLastPartsOfTheirPaths) {
  TemporaryFolder folder;
  folder.write("images/003.JPG", "");
  const std::filesystem::path there = folder.path / "images/003.JPG";
  for (const char* name :
       {"images/003.JPG", "images/003.jpg", "C:/set/images/003.jpg",
        R"(C:\Users\set\images\003.jpg)", "/home/somebody/images/003", "../images/003.JPG"})
    EXPECT_EQ(photographs::find_image(folder.path, name).lexically_normal(), there) << name;
  EXPECT_EQ(photographs::find_image(folder.path, "images/004.JPG"), "");
  EXPECT_THAT(
      input_error([&] { photographs::refuse_without_images(folder.path, "images/004.JPG"); }),
      AllOf(HasSubstr(folder.path.string() + "/images/004.JPG"), HasSubstr("003.JPG beside it")));
}

TEST(Photographs, IntrinsicsFollowSmallerImages) {
  TemporaryFolder folder;
  write_image(folder.path / "a.png", {80, 60, std::vector<std::uint8_t>(3 * 80 * 60)});
  CameraCalibration calibration;
  calibration.name = "camera";
  calibration.width = 160;
  calibration.height = 120;
  calibration.parameters = {100, 110, 79.5, 59.5, 0.1};
  Recording recording;
  recording.cameras = {{calibration, {{{0, folder.path / "a.png"}, {}, false}}}};
  photographs::fit_to_images(&recording);
  const CameraCalibration& fitted = recording.cameras[0].calibration;
  EXPECT_EQ(fitted.width, 80);
  EXPECT_EQ(fitted.height, 60);
  EXPECT_EQ(fitted.parameters, (std::vector<double>{50, 55, 39.5, 29.5, 0.1}));
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_THAT(recording.findings[0].what, HasSubstr("80 x 60"));

  calibration.height = 140;  // another aspect
  recording.cameras[0].calibration = calibration;
  photographs::fit_to_images(&recording);
  EXPECT_EQ(recording.cameras[0].calibration.height, 140);
}

}  // namespace
}  // namespace redrive
