// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/image_head.h"

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/image/image.h"
#include "redrive/image/jpeg.h"
#include "redrive/image/png.h"

namespace redrive {
namespace {

Image8 colours(int width, int height) {
  Image8 image{width, height, {}};
  for (int i = 0; i < 3 * width * height; ++i)
    image.rgb.push_back(static_cast<std::uint8_t>(i * 7));
  return image;
}

/// An EXIF segment with a focal length of 26 mm, in either order of bytes.
std::string exif(bool big_endian) {
  std::string tiff = big_endian ? "MM" : "II";
  const auto put = [&](unsigned value, int size) {
    for (int i = 0; i < size; ++i)
      tiff += static_cast<char>(value >> (8 * (big_endian ? size - 1 - i : i)));
  };
  const auto entry = [&](unsigned tag, unsigned type, unsigned value) {
    put(tag, 2), put(type, 2), put(1, 4);
    type == 3 ? (put(value, 2), put(0, 2)) : put(value, 4);
  };
  put(42, 2), put(8, 4);            // the first directory
  put(1, 2), entry(0x8769, 4, 26);  // the one of EXIF
  put(0, 4);                        // no further one; now at 26
  put(2, 2), entry(0x9207, 3, 5), entry(0xA405, 3, 26), put(0, 4);
  const std::string body = std::string("Exif\0\0", 6) + tiff;
  const auto length = static_cast<unsigned>(body.size() + 2);
  return std::string("\xFF\xE1") + static_cast<char>(length >> 8) + static_cast<char>(length) +
         body;
}

TEST(ImageHead, OfColourImages) {
  for (const std::string& bytes : {encode_png(colours(40, 30)), encode_jpeg(colours(40, 30), 90)}) {
    const auto head = parse_image_head(bytes);
    ASSERT_TRUE(head);
    EXPECT_EQ(head->width, 40);
    EXPECT_EQ(head->height, 30);
    EXPECT_FALSE(head->grey);
    EXPECT_FALSE(head->focal_px());
    for (std::size_t n = 0; n < 26; ++n) EXPECT_FALSE(parse_image_head(bytes.substr(0, n))) << n;
  }
  EXPECT_FALSE(parse_image_head("GIF89a"));
}

TEST(ImageHead, OfGreyOnes) {
  const std::string png("\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x28\0\0\0\x1e\x08\0\0\0\0", 29);
  ASSERT_TRUE(parse_image_head(png));
  EXPECT_TRUE(parse_image_head(png)->grey);
  const std::string jpeg("\xFF\xD8\xFF\xC0\0\x0B\x08\0\x1E\0\x28\x01\x01\x11\0", 15);
  ASSERT_TRUE(parse_image_head(jpeg));
  EXPECT_TRUE(parse_image_head(jpeg)->grey);
  EXPECT_EQ(parse_image_head(jpeg)->width, 40);
}

TEST(ImageHead, FocalLengthOfExif) {
  for (const bool big_endian : {false, true}) {
    std::string bytes = encode_jpeg(colours(40, 30), 90);
    bytes.insert(2, exif(big_endian));
    const auto head = parse_image_head(bytes);
    ASSERT_TRUE(head);
    ASSERT_TRUE(head->film_focal_mm);
    EXPECT_EQ(*head->film_focal_mm, 26);
    EXPECT_NEAR(*head->focal_px(), 26 * 50 / 43.267, 0.01);
  }
}

TEST(ImageHead, ACutFileHasNoEnd) {
  const TemporaryFolder folder;
  for (const std::string& bytes : {encode_png(colours(40, 30)), encode_jpeg(colours(40, 30), 90)}) {
    folder.write("whole", bytes);
    folder.write("cut", bytes.substr(0, bytes.size() - 1));
    EXPECT_TRUE(read_image_ends(folder.path / "whole").has_end);
    EXPECT_EQ(read_image_ends(folder.path / "whole").bytes, bytes.size());
    EXPECT_EQ(read_image_ends(folder.path / "whole").head->width, 40);
    EXPECT_FALSE(read_image_ends(folder.path / "cut").has_end);
  }
  folder.write("empty", "");
  EXPECT_FALSE(read_image_ends(folder.path / "empty").has_end);
  EXPECT_EQ(read_image_ends(folder.path / "empty").bytes, 0u);
  EXPECT_THROW(read_image_ends(folder.path / "missing"), InputError);
}

}  // namespace
}  // namespace redrive
