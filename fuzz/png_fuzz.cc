// SPDX-License-Identifier: Apache-2.0
// PNG: decodes any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/image/png.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  try {
    const redrive::Image8 image = redrive::decode_png(bytes, "image.png");
    if (redrive::decode_png(redrive::encode_png(image), "").rgb != image.rgb) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  try {
    const redrive::Image16 image = redrive::decode_png16(bytes, "depth.png");
    if (redrive::decode_png16(redrive::encode_png16(image), "").values != image.values)
      __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
