// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/image_io.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/image/image_testing.h"

namespace redrive {
namespace {

using testing::HasSubstr;

class ImageFiles : public ::testing::Test {
 protected:
  std::string read_error(const std::filesystem::path& path) {
    try {
      read_image(path);
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr(path.filename().string()));
      return error.what();
    }
    ADD_FAILURE() << path << " was read";
    return "";
  }

  TemporaryFolder folder_;
  const std::filesystem::path& root_ = folder_.path;
};

TEST_F(ImageFiles, PngKeepsColoursAndAlpha) {
  Image8 image = smooth_image(37, 21);
  write_image(root_ / "rgb.png", image);
  Image8 back = read_image(root_ / "rgb.png");
  EXPECT_EQ(back.width, 37);
  EXPECT_EQ(back.height, 21);
  EXPECT_EQ(back.rgb, image.rgb);
  EXPECT_TRUE(back.alpha.empty());
  for (int i = 0; i < 37 * 21; ++i) image.alpha.push_back(static_cast<std::uint8_t>(3 * i));
  write_image(root_ / "rgba.png", image);
  back = read_image(root_ / "rgba.png");
  EXPECT_EQ(back.rgb, image.rgb) << "not multiplied";
  EXPECT_EQ(back.alpha, image.alpha);
}

TEST_F(ImageFiles, Png16KeepsValues) {
  Image16 image{4, 3, {}};
  for (int i = 0; i < 12; ++i) image.values.push_back(static_cast<std::uint16_t>(5957 * i));
  write_png16(root_ / "d.png", image);
  const Image16 back = read_png16(root_ / "d.png");
  EXPECT_EQ(back.width, 4);
  EXPECT_EQ(back.height, 3);
  EXPECT_EQ(back.values, image.values);
}

TEST_F(ImageFiles, Png16RejectsOtherImages) {
  write_image(root_ / "a.png", smooth_image(4, 3));
  EXPECT_THROW(read_png16(root_ / "a.png"), InputError);
  write_image(root_ / "a.jpg", smooth_image(4, 3));
  EXPECT_THROW(read_png16(root_ / "a.jpg"), InputError);
  EXPECT_THROW(write_png16(root_ / "d.jpg", {1, 1, {7}}), UsageError);
}

TEST_F(ImageFiles, JpegKeepsColoursNearly) {
  const Image8 image = smooth_image(64, 48);
  write_image(root_ / "a.jpg", image);
  const Image8 back = read_image(root_ / "a.jpg");
  ASSERT_EQ(back.rgb.size(), image.rgb.size());
  // Red, green and blue in their places: the channels differ by up to 200, quality 92 changes a
  // smooth image by a few levels.
  for (std::size_t i = 0; i < image.rgb.size(); ++i) ASSERT_NEAR(back.rgb[i], image.rgb[i], 8) << i;
}

TEST_F(ImageFiles, RejectsFilesTruncatedAnywhere) {
  for (const char* name : {"whole.jpg", "whole.png"}) {
    write_image(root_ / name, smooth_image(64, 48));
    const std::string bytes = read_file(root_ / name);
    const auto cut =
        root_ / (std::string("cut") + std::filesystem::path(name).extension().string());
    for (std::size_t size = 0; size < bytes.size(); size += 1 + bytes.size() / 60) {
      write_file(cut, std::string_view(bytes).substr(0, size));
      read_error(cut);
    }
    write_file(cut, std::string_view(bytes).substr(0, bytes.size() - (name[6] == 'p' ? 13 : 3)));
    read_error(cut);
  }
}

TEST_F(ImageFiles, RejectsOtherFiles) {
  EXPECT_THROW(read_image(root_ / "missing.jpg"), InputError);
  write_file(root_ / "text.jpg", "this is not an image");
  EXPECT_THAT(read_error(root_ / "text.jpg"), HasSubstr("neither"));
  write_file(root_ / "empty.png", "");
  EXPECT_THAT(read_error(root_ / "empty.png"), HasSubstr("empty"));
  EXPECT_THROW(write_image(root_ / "a.bmp", smooth_image(4, 4)), UsageError);
  EXPECT_THROW(write_image(root_ / "no/such/folder/a.png", smooth_image(4, 4)), IoError);
}

}  // namespace
}  // namespace redrive
