// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/camera_choice.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;

/// A rig of cameras whose first pixel has these colours.
Recording rig(const TemporaryFolder& folder,
              const std::vector<std::pair<std::string, std::array<std::uint8_t, 3>>>& cameras) {
  Recording recording;
  for (const auto& [name, colour] : cameras) {
    Image8 image{8, 8, std::vector<std::uint8_t>(192, 90)};
    std::ranges::copy(colour, image.rgb.begin());
    const auto path = folder.path / (name + ".png");
    write_image(path, image);
    RecordedCamera camera;
    camera.calibration.name = name;
    camera.images.push_back({{0, path}, {}, false});
    recording.cameras.push_back(camera);
  }
  return recording;
}

TEST(CameraChoice, KeepsNamedCameras) {
  const TemporaryFolder folder;
  Recording recording = rig(folder, {{"A", {}}, {"B", {}}, {"C", {}}});
  keep_cameras({}, &recording);
  EXPECT_EQ(recording.cameras.size(), 3u);
  EXPECT_THROW(keep_cameras({"D"}, &recording), UsageError);
  EXPECT_THROW(keep_cameras({"A", "A"}, &recording), UsageError);
  keep_cameras({"C", "A"}, &recording);
  ASSERT_EQ(recording.cameras.size(), 2u);
  EXPECT_EQ(recording.cameras[1].calibration.name, "C");
}

TEST(CameraChoice, NamesGreyCameras) {
  const TemporaryFolder folder;
  Recording recording = rig(folder, {{"A", {1, 2, 3}}, {"B", {7, 7, 7}}, {"C", {9, 9, 8}}});
  EXPECT_THAT(grey_cameras(recording), ElementsAre("B"));
  recording.cameras[1].images[0].path = folder.path / "missing.png";
  EXPECT_THAT(grey_cameras(recording), ElementsAre());
}

}  // namespace
}  // namespace redrive
