// SPDX-License-Identifier: Apache-2.0
// Boxes of KITTI-360: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/kitti360/kitti360_boxes.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    for (const redrive::kitti360::Object& object : redrive::kitti360::parse_objects(text, "b.xml"))
      if (!redrive::rigid_obstacle(object.world_from_box.matrix()).empty() ||
          !(object.size_m.minCoeff() >= 0.01) || object.frame_id < redrive::kitti360::kStatic)
        __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
