// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/image_size.h"

#include <string>

#include "redrive/base/error.h"
#include "redrive/image/image_head.h"

namespace redrive {
namespace {

std::string size_text(ImageSize size) {
  return std::to_string(size.width) + " x " + std::to_string(size.height);
}

}  // namespace

std::optional<ImageSize> image_size(const std::filesystem::path& path) {
  const std::optional<ImageHead> head = read_image_head(path);
  if (!head) return std::nullopt;
  const ImageSize size{head->width, head->height};
  constexpr int kMaxSide = 65536;
  if (size.width < 1 || size.height < 1 || size.width > kMaxSide || size.height > kMaxSide)
    throw InputError(path, "size", size_text(size), "expected 1 to 65536 pixels a side");
  return size;
}

void check_image_size(const std::filesystem::path& image, ImageSize expected,
                      const std::filesystem::path& calibration) {
  const std::optional<ImageSize> size = image_size(image);
  if (size && *size != expected)
    throw InputError(image, "size", size_text(*size),
                     calibration.string() + " has " + size_text(expected));
}

}  // namespace redrive
