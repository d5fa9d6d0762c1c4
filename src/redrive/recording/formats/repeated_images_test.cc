// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/repeated_images.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;

class RepeatedImages : public ::testing::Test {
 protected:
  /// The bytes of an image, another one for each seed.
  std::string image(char seed, const std::string& extension = ".png") const {
    Image8 pixels{kSide, kSide, std::vector<std::uint8_t>(3 * kSide * kSide)};
    std::uint32_t state = static_cast<unsigned char>(seed);
    for (std::uint8_t& value : pixels.rgb)
      value = static_cast<std::uint8_t>((state = state * 48271 % 2147483647) >> 8);
    const std::filesystem::path file = folder_.path / ("image" + extension);
    write_image(file, pixels);
    return read_file(file);
  }
  Recording drive_of(const std::string& seeds, double step_m) {
    std::vector<std::string> images;
    for (const char seed : seeds) images.push_back(image(seed));
    return drive(images, step_m);
  }
  /// A camera whose images hold these bytes, `step_m` apart.
  Recording drive(const std::vector<std::string>& images, double step_m) {
    Recording recording;
    recording.cameras.resize(1);
    recording.cameras[0].calibration.name = "CAM";
    recording.cameras[0].calibration.width = recording.cameras[0].calibration.height = kSide;
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

  static constexpr int kSide = 64;
  TemporaryFolder folder_;
};

TEST_F(RepeatedImages, AreLeftOutBeyondTheFirst) {
  const Recording recording = drive_of("abbbcdb", 0.8);
  EXPECT_THAT(kept(recording), ElementsAre(0, 1, 4, 5, 6));
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_EQ(recording.findings[0].subject, "CAM");
  EXPECT_EQ(recording.findings[0].what,
            "2 images left out, which repeat the pixels of the one before while the poses move on: "
            "frames 2, 3");
}

TEST_F(RepeatedImages, AreKeptWhereTheCarStands) {
  EXPECT_EQ(drive_of("aaa", 0.001).cameras[0].images.size(), 3u);
  EXPECT_THAT(kept(drive_of("aaaaab", 0.02)), ElementsAre(0, 1, 2, 5))
      << "it creeps: 6 cm from the first one on";
}

TEST_F(RepeatedImages, CamerasThatNeverChangeAreNamed) {
  const Recording recording = drive_of("aaa", 1);
  EXPECT_EQ(recording.cameras[0].images.size(), 3u);
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_EQ(recording.findings[0].what,
            "all 3 images have the same pixels, while the poses move on");
}

TEST_F(RepeatedImages, MayDifferInMetadata) {
  const auto with_comment = [](const std::string& jpeg, const std::string& text) {
    const std::string segment = std::string("\xff\xfe\0", 3) + char(2 + text.size()) + text;
    return jpeg.substr(0, 2) + segment + jpeg.substr(2);
  };
  const std::string jpeg = image('a', ".jpg");
  EXPECT_THAT(kept(drive({with_comment(jpeg, "10:00:01"), with_comment(jpeg, "10:00:02.5"),
                          with_comment(image('b', ".jpg"), "10:00:02.5"), image('c', ".jpg")},
                         1)),
              ElementsAre(0, 2, 3));
}

// Damage is not called a repetition: leave_out_damaged names each of these.
TEST_F(RepeatedImages, DamagedFilesThatAreEqualAreKept) {
  const std::string whole = image('a'), cut = whole.substr(0, whole.size() / 2);
  const Recording recording = drive({whole, cut, cut, cut}, 1);
  EXPECT_EQ(recording.cameras[0].images.size(), 4u);
  EXPECT_TRUE(recording.findings.empty());
}

TEST_F(RepeatedImages, EmptyAndMissingFilesAreNoRepetition) {
  EXPECT_EQ(drive({"", "", ""}, 1).cameras[0].images.size(), 3u);
  Recording recording = drive_of("ab", 1);
  recording.cameras[0].images[0].path = folder_.path / "missing";
  leave_out_repeated_images(&recording);
  EXPECT_EQ(recording.cameras[0].images.size(), 2u);
}

}  // namespace
}  // namespace redrive
