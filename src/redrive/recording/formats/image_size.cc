// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/image_size.h"

#include <algorithm>

#include "redrive/base/evenly_spaced.h"
#include "redrive/image/image_head.h"

namespace redrive {

std::optional<ImageSize> image_size(const std::filesystem::path& path) {
  constexpr int kMaxSide = 65536;
  const std::optional<ImageHead> head = read_image_head(path);
  if (!head || head->width > kMaxSide || head->height > kMaxSide) return std::nullopt;
  return ImageSize{head->width, head->height};
}

std::optional<ImageSize> usual_image_size(const std::vector<ImageFile>& images) {
  constexpr std::size_t kFew = 5;
  std::vector<ImageSize> sizes;
  for (const std::size_t i : evenly_spaced(images.size(), kFew))
    if (const auto size = image_size(images[i].path)) sizes.push_back(*size);
  if (sizes.empty()) return std::nullopt;
  return *std::ranges::max_element(sizes, {},
                                   [&](ImageSize size) { return std::ranges::count(sizes, size); });
}

}  // namespace redrive
