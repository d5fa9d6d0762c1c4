// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/png_size.h"

#include <cstring>
#include <fstream>
#include <string>

#include "redrive/base/error.h"

namespace redrive {
namespace {

std::string size_text(ImageSize size) {
  return std::to_string(size.width) + " x " + std::to_string(size.height);
}

}  // namespace

std::optional<ImageSize> png_size(const std::filesystem::path& path) {
  unsigned char head[24] = {};
  std::ifstream(path, std::ios::binary).read(reinterpret_cast<char*>(head), sizeof head);
  if (std::memcmp(head, "\x89PNG\r\n\x1a\n", 8) != 0) return std::nullopt;
  const auto big_endian = [&](int at) {
    return head[at] << 24 | head[at + 1] << 16 | head[at + 2] << 8 | head[at + 3];
  };
  const ImageSize size{big_endian(16), big_endian(20)};
  constexpr int kMaxSide = 65536;
  if (size.width < 1 || size.height < 1 || size.width > kMaxSide || size.height > kMaxSide)
    throw InputError(path, "size", size_text(size), "expected 1 to 65536 pixels a side");
  return size;
}

void check_png_size(const std::filesystem::path& image, ImageSize expected,
                    const std::filesystem::path& calibration) {
  const std::optional<ImageSize> size = png_size(image);
  if (size && (size->width != expected.width || size->height != expected.height))
    throw InputError(image, "size", size_text(*size),
                     calibration.string() + " has " + size_text(expected));
}

}  // namespace redrive
