// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/png.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

enum ColourType { kGrey = 0, kRgb = 2, kPalette = 3, kGreyAlpha = 4, kRgba = 6 };

std::string big_endian(std::uint32_t value) {
  return {static_cast<char>(value >> 24), static_cast<char>(value >> 16),
          static_cast<char>(value >> 8), static_cast<char>(value)};
}

std::string chunk(const std::string& type, const std::string& data) {
  const std::string body = type + data;
  const auto checksum =
      crc32(0, reinterpret_cast<const Bytef*>(body.data()), static_cast<uInt>(body.size()));
  return big_endian(static_cast<std::uint32_t>(data.size())) + body +
         big_endian(static_cast<std::uint32_t>(checksum));
}

std::string deflated(const std::string& raw) {
  std::string out(compressBound(raw.size()), '\0');
  uLongf size = out.size();
  EXPECT_EQ(compress(reinterpret_cast<Bytef*>(out.data()), &size,
                     reinterpret_cast<const Bytef*>(raw.data()), raw.size()),
            Z_OK);
  out.resize(size);
  return out;
}

struct Header {
  std::uint32_t width, height;
  char bits;
  ColourType type;
  bool interlaced = false;
};

/// A PNG file byte by byte (ISO/IEC 15948). `raw`: rows, each behind its filter byte 0; `chunks`:
/// between header and pixels.
std::string png_file(const Header& header, const std::string& raw, const std::string& chunks = "") {
  std::string ihdr = big_endian(header.width) + big_endian(header.height);
  ihdr += {header.bits, static_cast<char>(header.type), 0, 0, header.interlaced ? '\1' : '\0'};
  return "\x89PNG\r\n\x1a\n" + chunk("IHDR", ihdr) + chunks + chunk("IDAT", deflated(raw)) +
         chunk("IEND", "");
}

std::string bytes_of(std::initializer_list<int> values) {
  std::string bytes;
  for (const int value : values) bytes += static_cast<char>(value);
  return bytes;
}

std::string png_error_text(const std::string& bytes) {
  try {
    decode_png(bytes, "file.png");
  } catch (const InputError& error) {
    return error.what();
  }
  ADD_FAILURE() << "decoded";
  return "";
}

TEST(Png, ExpandsGreyOfFewBits) {
  const Image8 image = decode_png(png_file({4, 1, 2, kGrey}, bytes_of({0, 0b00011011})), "");
  EXPECT_THAT(image.rgb, ElementsAre(0, 0, 0, 85, 85, 85, 170, 170, 170, 255, 255, 255));
  EXPECT_TRUE(image.alpha.empty());
}

TEST(Png, Rounds16BitsTo8) {
  std::string raw(1, '\0');
  std::vector<int> expected;
  for (int value = 0; value < 65536; value += 16) {
    raw += bytes_of({value >> 8, value & 255});
    expected.insert(expected.end(), 3, (value + 128) / 257);
  }
  const Image8 image = decode_png(png_file({4096, 1, 16, kGrey}, raw), "");
  EXPECT_TRUE(std::ranges::equal(image.rgb, expected));
}

TEST(Png, ExpandsPalettesWithTransparency) {
  const std::string palette = chunk("PLTE", bytes_of({10, 20, 30, 40, 50, 60, 70, 80, 90})),
                    transparency = chunk("tRNS", bytes_of({0, 128}));
  const std::string raw = bytes_of({0, 0b00011000});
  Image8 image = decode_png(png_file({3, 1, 2, kPalette}, raw, palette + transparency), "");
  EXPECT_THAT(image.rgb, ElementsAre(10, 20, 30, 40, 50, 60, 70, 80, 90));
  EXPECT_THAT(image.alpha, ElementsAre(0, 128, 255));
  image = decode_png(png_file({3, 1, 2, kPalette}, raw, palette), "");
  EXPECT_THAT(image.rgb, ElementsAre(10, 20, 30, 40, 50, 60, 70, 80, 90));
  EXPECT_TRUE(image.alpha.empty());
}

TEST(Png, ReadsAlphaOfEveryKind) {
  Image8 image = decode_png(png_file({2, 1, 8, kGreyAlpha}, bytes_of({0, 7, 1, 9, 255})), "");
  EXPECT_THAT(image.rgb, ElementsAre(7, 7, 7, 9, 9, 9));
  EXPECT_THAT(image.alpha, ElementsAre(1, 255));
  image = decode_png(png_file({1, 1, 16, kRgba}, bytes_of({0, 1, 1, 2, 2, 3, 3, 0xff, 0xff})), "");
  EXPECT_THAT(image.rgb, ElementsAre(1, 2, 3));
  EXPECT_THAT(image.alpha, ElementsAre(255));
  const std::string transparent_grey = chunk("tRNS", bytes_of({0, 7}));
  image = decode_png(png_file({2, 1, 8, kGrey}, bytes_of({0, 7, 9}), transparent_grey), "");
  EXPECT_THAT(image.alpha, ElementsAre(0, 255));
}

TEST(Png, ReadsInterlacedImages) {
  // Adam7 has the first of 2 x 2 pixels in pass 1, its right neighbour in pass 6, row 1 in pass 7.
  const std::string raw = bytes_of({0, 1, 0, 2, 0, 3, 4});
  EXPECT_THAT(decode_png(png_file({2, 2, 8, kGrey, true}, raw), "").rgb,
              ElementsAre(1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4));
}

TEST(Png, IgnoresBrokenColourProfiles) {
  const std::string profile = chunk("iCCP", "name" + bytes_of({0, 0}) + deflated("not a profile"));
  EXPECT_THAT(decode_png(png_file({1, 1, 8, kRgb}, bytes_of({0, 1, 2, 3}), profile), "").rgb,
              ElementsAre(1, 2, 3));
}

TEST(Png, RejectsDamagedFiles) {
  std::string bytes = encode_png({8, 8, std::vector<std::uint8_t>(3 * 64, 99)});
  bytes[bytes.size() - 20] ^= 0x55;  // the checksum of the pixels no longer holds
  EXPECT_THAT(png_error_text(bytes),
              AllOf(HasSubstr("file.png"), HasSubstr("damaged"), HasSubstr("IDAT")));
  EXPECT_THAT(png_error_text(png_file({2, 2, 8, kRgb}, bytes_of({0, 1, 2, 3}))),
              HasSubstr("Not enough image data"));
  EXPECT_THAT(png_error_text(png_file({0, 2, 8, kRgb}, "")), HasSubstr("damaged"));
  EXPECT_THAT(png_error_text(png_file({1, 1, 8, kPalette}, bytes_of({0, 0}))), HasSubstr("PLTE"));
}

TEST(Png, RejectsHeadersThatClaimMoreThanTheFileHolds) {
  EXPECT_THAT(png_error_text(png_file({16000, 16000, 8, kRgba}, "")),
              AllOf(HasSubstr("16000 x 16000"), HasSubstr("cannot hold")));
  EXPECT_THAT(png_error_text(png_file({20000, 20000, 1, kGrey}, "")), HasSubstr("too large"));
  EXPECT_THAT(png_error_text(png_file({2'000'000, 1, 1, kGrey}, "")), HasSubstr("IHDR"));
}

TEST(Png, ReadsTheMostCompressibleImage) {
  const Image8 black{4096, 1024, std::vector<std::uint8_t>(3 * 4096 * 1024)};
  EXPECT_EQ(decode_png(encode_png(black), "").rgb, black.rgb);
}

TEST(Png, Decodes16BitsInNativeOrder) {
  EXPECT_THAT(decode_png16(png_file({2, 1, 16, kGrey}, bytes_of({0, 1, 2, 0xff, 0xfe})), "").values,
              ElementsAre(0x0102, 0xfffe));
  EXPECT_THROW(decode_png16(png_file({2, 1, 8, kGrey}, bytes_of({0, 1, 2})), ""), InputError);
}

}  // namespace
}  // namespace redrive
