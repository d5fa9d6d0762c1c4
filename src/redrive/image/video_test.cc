// SPDX-License-Identifier: Apache-2.0
// Reads videos back by ffprobe and ffmpeg; skips where they are missing.
#include "redrive/image/video.h"

#include <cstdio>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// One colour that changes from image to image: chroma loses nothing.
Image8 image_of(int width, int height, int index) {
  Image8 image{width, height};
  for (int i = 0; i < width * height; ++i)
    for (const int value : {40 + 15 * index, 200 - 10 * index, 90})
      image.rgb.push_back(static_cast<std::uint8_t>(value));
  return image;
}

/// Returns what a command prints.
std::string printed(const std::string& command) {
  FILE* const pipe = popen((command + " 2>&1").c_str(), "r");
  std::string text;
  for (int c = std::fgetc(pipe); c != EOF; c = std::fgetc(pipe)) text += static_cast<char>(c);
  EXPECT_EQ(pclose(pipe), 0) << text;
  return text;
}

bool has_programs() {
  return std::system("ffprobe -version >/dev/null 2>&1 && ffmpeg -version >/dev/null 2>&1") == 0;
}

/// Returns what ffprobe knows of a video's only stream.
nlohmann::json stream_of(const fs::path& file) {
  return nlohmann::json::parse(
             printed("ffprobe -v error -count_frames -show_streams -of json " + file.string()))
      .at("streams")
      .at(0);
}

class Video : public testing::Test {
 protected:
  void SetUp() override {
    if (const auto obstacle = video_obstacle()) GTEST_SKIP() << *obstacle;
  }
  void write(int width, int height, double fps, int images) const {
    VideoWriter video(file, width, height, fps);
    for (int i = 0; i < images; ++i) video.add(image_of(width, height, i));
    EXPECT_FALSE(fs::exists(file));
    video.finish();
  }
  const TemporaryFolder folder;
  const fs::path file = folder.path / "a.mp4";
};

TEST_F(Video, HasTheImagesInTheirTimeAndColours) {
  if (!has_programs()) GTEST_SKIP() << "there is no ffprobe (Debian package ffmpeg)";
  write(64, 48, 12.5, 10);
  const nlohmann::json stream = stream_of(file);
  EXPECT_EQ(stream.at("codec_name"), "h264");
  EXPECT_EQ(stream.at("pix_fmt"), "yuv420p");
  EXPECT_EQ(stream.at("color_space"), "bt709");
  EXPECT_EQ(stream.at("width"), 64);
  EXPECT_EQ(stream.at("height"), 48);
  EXPECT_EQ(stream.at("avg_frame_rate"), "25/2");
  EXPECT_EQ(stream.at("nb_read_frames"), "10");
  EXPECT_NEAR(std::stod(stream.at("duration").get<std::string>()), 0.8, 1e-3);

  printed("ffmpeg -v error -i " + file.string() + " " + (folder.path / "%d.png").string());
  for (const int index : {0, 4, 9}) {
    const Image8 found = read_image(folder.path / (std::to_string(index + 1) + ".png")),
                 expected = image_of(64, 48, index);
    ASSERT_EQ(found.rgb.size(), expected.rgb.size());
    // crf 18 and 219 steps of luma for 255 cost a few grey levels.
    for (std::size_t i = 0; i < found.rgb.size(); ++i)
      ASSERT_NEAR(found.rgb[i], expected.rgb[i], 6) << "image " << index;
  }
}

TEST_F(Video, PlaysWhileItLoads) {
  write(32, 32, 24, 3);
  const std::string bytes = read_file(file);
  EXPECT_LT(bytes.find("moov"), bytes.find("mdat")) << "the index comes first";
}

TEST_F(Video, LeavesOutAnOddColumnAndRow) {
  if (!has_programs()) GTEST_SKIP() << "there is no ffprobe (Debian package ffmpeg)";
  write(33, 17, 24, 2);
  const nlohmann::json stream = stream_of(file);
  EXPECT_EQ(stream.at("width"), 32);
  EXPECT_EQ(stream.at("height"), 16);
}

TEST_F(Video, HasANameWithAColon) {
  const fs::path before = fs::current_path();
  fs::current_path(folder.path);
  EXPECT_NO_THROW({
    VideoWriter video("left:1.mp4", 16, 16, 24);
    video.add(image_of(16, 16, 0));
    video.finish();
  });
  fs::current_path(before);
  EXPECT_TRUE(fs::exists(folder.path / "left:1.mp4"));
}

TEST_F(Video, LeavesNothingHalfWritten) {
  { VideoWriter(file, 16, 16, 24).add(image_of(16, 16, 0)); }
  EXPECT_TRUE(fs::is_empty(folder.path));
  folder.write("a.mp4", "old");
  { VideoWriter(file, 16, 16, 24).add(image_of(16, 16, 0)); }
  EXPECT_EQ(read_file(file), "old");
  try {
    VideoWriter(folder.path / "no_folder" / "a.mp4", 16, 16, 24);
    FAIL();
  } catch (const IoError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("no_folder/a.mp4"));
  }
}

}  // namespace
}  // namespace redrive
