// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/png_size.h"

#include <cstdint>
#include <string>

#include "redrive/base/error.h"
#include "redrive/base/files.h"

namespace redrive {
namespace {

std::string size_text(ImageSize size) {
  return std::to_string(size.width) + " x " + std::to_string(size.height);
}

}  // namespace

std::optional<ImageSize> png_size(const std::filesystem::path& path) {
  constexpr std::size_t kHead = 24;
  const std::string head = read_head(path, kHead);
  if (head.size() < kHead || !head.starts_with("\x89PNG\r\n\x1a\n")) return std::nullopt;
  const auto big_endian = [&](std::size_t at) {
    std::uint32_t value = 0;
    for (std::size_t i = at; i < at + 4; ++i)
      value = value << 8 | static_cast<std::uint8_t>(head[i]);
    return static_cast<int>(value);
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
