// SPDX-License-Identifier: Apache-2.0
// transforms.json: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/photographs/transforms.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto size_of = [](const std::string& file) -> std::optional<redrive::ImageSize> {
    if (file.size() % 2 == 0) return std::nullopt;
    return redrive::ImageSize{800, 600};
  };
  try {
    const auto transforms = redrive::transforms::parse(text, "transforms.json", size_of);
    if (transforms.entries.empty()) __builtin_trap();
    for (const redrive::transforms::FrameEntry& entry : transforms.entries) {
      if (!entry.global_from_body.matrix().allFinite()) __builtin_trap();
      if (entry.camera &&
          !(entry.camera->fx() > 0 && entry.camera->fy() > 0 && entry.camera->width > 0))
        __builtin_trap();
    }
    if (transforms.bounds &&
        !(transforms.bounds->half_side > 0 && transforms.bounds->center.allFinite()))
      __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
