// SPDX-License-Identifier: Apache-2.0
// Images of a COLMAP model, as text and as binary: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/photographs/colmap_files.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  using namespace redrive::colmap;
  for (const auto parse : {parse_images_text, parse_images_binary}) {
    try {
      for (const auto& record : parse(bytes, "images"))
        if (record.name == ".." || record.name.starts_with("../") || record.name.starts_with("/"))
          __builtin_trap();
    } catch (const redrive::InputError&) {
    }
  }
  return 0;
}
