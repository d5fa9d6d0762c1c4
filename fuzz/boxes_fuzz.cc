// SPDX-License-Identifier: Apache-2.0
// Boxes of a frame: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/aimotive/aimotive_boxes.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    for (const redrive::Box& box : redrive::aimotive::parse_boxes(text, "frame.json")) {
      if (!redrive::rigid_obstacle(box.body_from_box.matrix()).empty() ||
          !(box.size_m.minCoeff() >= 0.01))
        __builtin_trap();
    }
  } catch (const redrive::InputError&) {
  }
  return 0;
}
