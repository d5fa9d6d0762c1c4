// SPDX-License-Identifier: Apache-2.0
// Pixels of messages in each encoding.
#include "redrive/recording/formats/rosbag/bag_images.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"

namespace redrive::rosbag {
namespace {

using ::testing::HasSubstr;

ImageMessage message(const std::string& encoding, std::uint32_t width, std::uint32_t height,
                     std::uint32_t step, const std::string& data) {
  ImageMessage image;
  image.encoding = encoding;
  image.width = width;
  image.height = height;
  image.step = step;
  image.size = data.size();
  image.data = data;
  return image;
}

/// The bytes behind the head of the PPM.
std::vector<int> pixels(const std::string& encoding, std::uint32_t width, std::uint32_t height,
                        std::uint32_t step, const std::string& data) {
  const ImageMessage image = message(encoding, width, height, step, data);
  const std::string ppm = as_ppm(image, ppm_bytes(image), "image");
  EXPECT_EQ(ppm.size(), ppm_bytes(image));
  const std::size_t n = std::size_t{width} * height * (encoding.starts_with("mono") ? 1 : 3);
  std::vector<int> out;
  for (const char c : ppm.substr(ppm.size() - n)) out.push_back(static_cast<unsigned char>(c));
  return out;
}

TEST(BagImages, ColoursInAnyOrderWithPaddedRows) {
  using Pixels = std::vector<int>;
  const Pixels expected = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12};
  EXPECT_EQ(pixels("rgb8", 2, 2, 7, "\1\2\3\4\5\6-\7\10\11\12\13\14-"), expected);
  EXPECT_EQ(pixels("bgr8", 2, 2, 6, "\3\2\1\6\5\4\11\10\7\14\13\12"), expected);
  EXPECT_EQ(pixels("8UC3", 2, 2, 6, "\3\2\1\6\5\4\11\10\7\14\13\12"), expected);
  EXPECT_EQ(pixels("rgba8", 2, 2, 8, "\1\2\3a\4\5\6a\7\10\11a\12\13\14a"), expected);
  EXPECT_EQ(pixels("bgra8", 2, 2, 8, "\3\2\1a\6\5\4a\11\10\7a\14\13\12a"), expected);
  EXPECT_EQ(pixels("mono8", 2, 2, 3, "\1\2-\3\4-"), (Pixels{1, 2, 3, 4}));
}

// ITU-R BT.601 with 16..235, as video has it: Y = 16 black, 235 white; V = 240 with Y = 81 red.
TEST(BagImages, Yuv422OfBothOrders) {
  constexpr char kGrey = '\x80';
  const std::string yuyv{'\x10', kGrey, '\xeb', kGrey, '\x51', '\x5a', '\x51', '\xf0'},
      uyvy{kGrey, '\x10', kGrey, '\xeb', '\x5a', '\x51', '\xf0', '\x51'};
  for (const auto& [encoding, data] :
       {std::pair("yuyv", yuyv), {"yuv422_yuy2", yuyv}, {"uyvy", uyvy}, {"yuv422", uyvy}}) {
    const std::vector<int> found = pixels(encoding, 4, 2, 8, data + data),
                           expected = {0, 0, 0, 255, 255, 255, 255, 0, 0, 255, 0, 0};
    for (std::size_t i = 0; i < expected.size(); ++i)
      EXPECT_NEAR(found[i], expected[i], 2) << encoding << i;
  }
}

TEST(BagImages, RefusesWhatIsNoImage) {
  const auto refused = [](const ImageMessage& image) -> std::string {
    try {
      as_ppm(image, 1'000'000, "image");
    } catch (const InputError& error) {
      return error.field;
    }
    return "nothing";
  };
  EXPECT_FALSE(is_known_encoding("16UC1"));
  EXPECT_EQ(refused(message("16UC1", 1, 1, 2, "ab")), "encoding");
  EXPECT_EQ(refused(message("rgb8", 2, 1, 5, "abcde")), "step, data");
  EXPECT_EQ(refused(message("rgb8", 2, 2, 6, "abcdef")), "step, data");
  EXPECT_EQ(refused(message("yuyv", 3, 1, 6, "abcdef")), "width, height");
  EXPECT_EQ(refused(message("rgb8", 0, 1, 0, "")), "width, height");
}

}  // namespace
}  // namespace redrive::rosbag
