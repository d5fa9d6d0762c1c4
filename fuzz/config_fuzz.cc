// SPDX-License-Identifier: Apache-2.0
// config.json: parses any bytes, and writes them back unchanged, or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/train/files/options.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = [](std::string_view text) {
    return redrive::options_to_json(
               redrive::options_from_json(redrive::parse_json(text, "config.json"), "config.json"))
        .dump(2);
  };
  try {
    const std::string text = read({reinterpret_cast<const char*>(data), size});
    if (read(text) != text) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
