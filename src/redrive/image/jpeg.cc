// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/jpeg.h"

#include <type_traits>

#include <turbojpeg.h>

#include "redrive/base/error.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

/// The first scan has at least a bit for each block of 8 x 8 pixels.
constexpr std::int64_t kMaxPixelsPerByte = 8 * 64;

struct DestroyCodec {
  void operator()(void* codec) const { tjDestroy(codec); }
};
using Codec = std::unique_ptr<std::remove_pointer_t<tjhandle>, DestroyCodec>;

}  // namespace

bool is_jpeg(std::string_view bytes) { return bytes.starts_with("\xff\xd8\xff"); }

Image8 decode_jpeg(std::string_view bytes, const std::filesystem::path& path) {
  const Codec codec(tjInitDecompress());
  REDRIVE_CHECK(codec != nullptr);
  const auto fail = [&](const std::string& rule) -> void {
    throw InputError(path, "", "", rule + ": " + tjGetErrorStr2(codec.get()));
  };
  const auto* const data = reinterpret_cast<const unsigned char*>(bytes.data());
  int width = 0, height = 0, subsampling = 0, colour_space = 0;
  if (tjDecompressHeader3(codec.get(), data, bytes.size(), &width, &height, &subsampling,
                          &colour_space) != 0)
    fail("not a readable JPEG");
  if (colour_space == TJCS_CMYK || colour_space == TJCS_YCCK)
    throw InputError(path, "colour space", "CMYK", "must be RGB, YCbCr or grey");
  const std::int64_t pixels = std::int64_t{width} * height;
  if (pixels > kMaxImagePixels)
    throw InputError(path, "size", size_text(width, height), "too large");
  if (pixels > kMaxPixelsPerByte * static_cast<std::int64_t>(bytes.size()))
    throw InputError(path, "size", size_text(width, height),
                     "the JPEG is truncated or damaged: its " + std::to_string(bytes.size()) +
                         " bytes cannot hold so many pixels");
  Image8 image{width, height, std::vector<std::uint8_t>(3 * static_cast<std::size_t>(pixels))};
  // Without STOPONWARNING, libjpeg fills the missing part of a truncated file with grey.
  if (tjDecompress2(codec.get(), data, bytes.size(), image.rgb.data(), width, 0, height, TJPF_RGB,
                    TJFLAG_STOPONWARNING | TJFLAG_LIMITSCANS) != 0)
    fail("the JPEG is truncated or damaged");
  return image;
}

std::string encode_jpeg(const Image8& image, int quality) {
  REDRIVE_CHECK_OP(image.rgb.size(), ==, std::size_t(3) * image.width * image.height);
  const Codec codec(tjInitCompress());
  REDRIVE_CHECK(codec != nullptr);
  std::string bytes(tjBufSize(image.width, image.height, TJSAMP_420), '\0');
  auto* data = reinterpret_cast<unsigned char*>(bytes.data());
  unsigned long size = bytes.size();
  REDRIVE_CHECK(tjCompress2(codec.get(), image.rgb.data(), image.width, 0, image.height, TJPF_RGB,
                            &data, &size, TJSAMP_420, quality,
                            TJFLAG_ACCURATEDCT | TJFLAG_NOREALLOC) == 0);
  bytes.resize(size);
  return bytes;
}

}  // namespace redrive
