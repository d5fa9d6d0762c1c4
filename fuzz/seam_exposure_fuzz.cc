// SPDX-License-Identifier: Apache-2.0
// exposure.json of two blocks: parses any bytes, and writes them back unchanged, or throws an
// InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/train/files/seam_exposure.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = [](std::string_view bytes) {
    return redrive::seam_exposure_text(redrive::parse_seam_exposure(bytes, "exposure.json", 2));
  };
  try {
    const std::string text = read({reinterpret_cast<const char*>(data), size});
    if (read(text) != text) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
