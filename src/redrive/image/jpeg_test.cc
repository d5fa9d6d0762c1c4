// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/jpeg.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <turbojpeg.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

using testing::AllOf;
using testing::Each;
using testing::HasSubstr;

constexpr int kSize = 32;

Image8 grey_image() { return {kSize, kSize, std::vector<std::uint8_t>(3 * kSize * kSize, 120)}; }

/// An image of kSize x kSize equal samples with quality 90.
std::string encoded(int pixel_format, int subsampling, int flags) {
  const tjhandle codec = tjInitCompress();
  const std::vector<unsigned char> samples(kSize * kSize * tjPixelSize[pixel_format], 120);
  unsigned char* data = nullptr;
  unsigned long size = 0;
  EXPECT_EQ(tjCompress2(codec, samples.data(), kSize, 0, kSize, pixel_format, &data, &size,
                        subsampling, 90, flags),
            0);
  std::string bytes(reinterpret_cast<const char*>(data), size);
  tjFree(data);
  tjDestroy(codec);
  return bytes;
}

/// `bytes` with another size in the header of its baseline frame (marker SOF0).
std::string with_size(std::string bytes, int width, int height) {
  const std::size_t frame = bytes.find("\xff\xc0");
  EXPECT_NE(frame, bytes.npos);
  for (const auto& [at, value] : {std::pair{frame + 5, height}, {frame + 7, width}}) {
    bytes[at] = static_cast<char>(value >> 8);
    bytes[at + 1] = static_cast<char>(value);
  }
  return bytes;
}

std::string jpeg_error(const std::string& bytes) {
  try {
    decode_jpeg(bytes, "file.jpg");
  } catch (const InputError& error) {
    return error.what();
  }
  ADD_FAILURE() << "decoded";
  return "";
}

TEST(Jpeg, ReadsGreyAndProgressiveImages) {
  EXPECT_THAT(decode_jpeg(encoded(TJPF_GRAY, TJSAMP_GRAY, 0), "").rgb, Each(120));
  EXPECT_THAT(decode_jpeg(encoded(TJPF_RGB, TJSAMP_444, TJFLAG_PROGRESSIVE), "").rgb, Each(120));
}

TEST(Jpeg, RejectsCmyk) {
  EXPECT_THAT(jpeg_error(encoded(TJPF_CMYK, TJSAMP_444, 0)),
              AllOf(HasSubstr("file.jpg"), HasSubstr("CMYK")));
}

TEST(Jpeg, IgnoresExifOrientation) {
  Image8 image = grey_image();
  image.height = kSize / 2;
  image.rgb.resize(image.rgb.size() / 2);
  std::string bytes = encode_jpeg(image, 90);
  // APP1: TIFF header, one entry 0x0112 (orientation) of type SHORT: 6, a quarter turn.
  const std::string exif(
      "Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0", 32);
  bytes.insert(2, std::string("\xff\xe1\0\x22", 4) + exif);
  const Image8 back = decode_jpeg(bytes, "");
  EXPECT_EQ(back.width, kSize);
  EXPECT_EQ(back.height, kSize / 2);
}

TEST(Jpeg, RejectsDamagedFiles) {
  std::string bytes = encode_jpeg(grey_image(), 90);
  bytes.replace(bytes.size() - 8, 2, "\xff\xd3", 2);  // a restart marker where none belongs
  EXPECT_THAT(jpeg_error(bytes), AllOf(HasSubstr("file.jpg"), HasSubstr("damaged")));
}

TEST(Jpeg, RejectsHeadersThatClaimMoreThanTheFileHolds) {
  const std::string bytes = encode_jpeg(grey_image(), 90);
  EXPECT_THAT(jpeg_error(with_size(bytes, 16000, 16000)),
              AllOf(HasSubstr("16000 x 16000"), HasSubstr("cannot hold")));
  EXPECT_THAT(jpeg_error(with_size(bytes, 65500, 65500)), HasSubstr("too large"));
  EXPECT_THAT(jpeg_error(with_size(bytes, 2 * kSize, kSize)), HasSubstr("truncated"));
}

}  // namespace
}  // namespace redrive
