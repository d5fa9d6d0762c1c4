// SPDX-License-Identifier: Apache-2.0
// LAS and LAZ: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/lidar/las.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  try {
    for (const redrive::LidarPoint& point : redrive::parse_las(bytes, "frame.laz")) {
      if (!(point.in_body_m.cwiseAbs().maxCoeff() <= 1e4f)) __builtin_trap();
    }
  } catch (const redrive::InputError&) {
  }
  return 0;
}
