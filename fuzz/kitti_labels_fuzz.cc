// SPDX-License-Identifier: Apache-2.0
// Labels of the tracking benchmark of KITTI: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/kitti/kitti_boxes.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    for (const redrive::Label& label : redrive::kitti::parse_labels(text, "0000.txt"))
      if (!redrive::rigid_obstacle(label.sensor_from_box.matrix()).empty() ||
          !(label.size_m.minCoeff() >= 0.01))
        __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
