// SPDX-License-Identifier: Apache-2.0
// PLY: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/lidar/ply.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  try {
    for (const Eigen::Vector3d& point : redrive::parse_ply(bytes, "points.ply")) {
      if (!(point.cwiseAbs().maxCoeff() <= 1e7)) __builtin_trap();
    }
  } catch (const redrive::InputError&) {
  }
  return 0;
}
