// SPDX-License-Identifier: Apache-2.0
// JPEG: decodes any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/image/jpeg.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  try {
    const redrive::Image8 image = redrive::decode_jpeg(bytes, "image.jpg");
    if (image.rgb.size() != std::size_t{3} * image.width * image.height) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
