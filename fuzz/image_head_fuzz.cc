// SPDX-License-Identifier: Apache-2.0
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/image/image_head.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  redrive::parse_image_head({reinterpret_cast<const char*>(data), size});
  return 0;
}
