// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/repeated_images.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/temporary_folder_testing.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;

class RepeatedImages : public ::testing::Test {
 protected:
  /// A camera whose images hold these bytes, `step_m` apart.
  Recording drive(const std::vector<std::string>& images, double step_m) {
    Recording recording;
    recording.cameras.resize(1);
    recording.cameras[0].calibration.name = "CAM";
    for (std::size_t i = 0; i < images.size(); ++i) {
      const auto id = static_cast<std::int64_t>(i);
      const std::string name = std::to_string(i) + ".png";
      folder_.write(name, images[i]);
      recording.cameras[0].images.push_back({{id, folder_.path / name}, {}, false});
      FramePose frame{id, 100'000'000 * id, Rigid3d::Identity()};
      frame.global_from_body.translation().x() = step_m * static_cast<double>(id);
      recording.frames.push_back(frame);
    }
    leave_out_repeated_images(&recording);
    return recording;
  }
  static std::vector<std::int64_t> kept(const Recording& recording) {
    std::vector<std::int64_t> ids;
    for (const ImageFile& image : recording.cameras[0].images) ids.push_back(image.frame_id);
    return ids;
  }

  TemporaryFolder folder_;
};

TEST_F(RepeatedImages, AreLeftOutBeyondTheFirst) {
  const Recording recording = drive({"a", "b", "b", "b", "c", "d", "b"}, 0.8);
  EXPECT_THAT(kept(recording), ElementsAre(0, 1, 4, 5, 6));
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_EQ(recording.findings[0].subject, "CAM");
  EXPECT_EQ(recording.findings[0].what,
            "2 images left out, which repeat the pixels of the one before while the poses move on: "
            "frames 2, 3");
}

TEST_F(RepeatedImages, AreKeptWhereTheCarStands) {
  EXPECT_EQ(drive({"a", "a", "a"}, 0.001).cameras[0].images.size(), 3u);
  EXPECT_THAT(kept(drive({"a", "a", "a", "a", "a", "b"}, 0.02)), ElementsAre(0, 1, 2, 5))
      << "it creeps: 6 cm from the first one on";
}

TEST_F(RepeatedImages, CamerasThatNeverChangeAreNamed) {
  const Recording recording = drive({"a", "a", "a"}, 1);
  EXPECT_EQ(recording.cameras[0].images.size(), 3u);
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_EQ(recording.findings[0].what,
            "all 3 images have the same pixels, while the poses move on");
}

TEST_F(RepeatedImages, MayDifferInMetadata) {
  std::string pixels(9000, 'x');
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<char>(i * i % 251);
  const std::string at_one = "header 10:00:01 " + pixels, at_two = "header 10:00:02.5 " + pixels;
  std::string other = at_two;
  for (std::size_t i = 1000; i < 8000; i += 7) ++other[i];
  EXPECT_THAT(kept(drive({at_one, at_two, other, pixels.substr(0, 5000)}, 1)),
              ElementsAre(0, 2, 3));
}

TEST_F(RepeatedImages, EmptyAndMissingFilesAreNoRepetition) {
  EXPECT_EQ(drive({"", "", ""}, 1).cameras[0].images.size(), 3u);
  Recording recording = drive({"a", "b"}, 1);
  recording.cameras[0].images[0].path = folder_.path / "missing";
  leave_out_repeated_images(&recording);
  EXPECT_EQ(recording.cameras[0].images.size(), 2u);
}

}  // namespace
}  // namespace redrive
