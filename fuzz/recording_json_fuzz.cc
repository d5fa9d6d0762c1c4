// SPDX-License-Identifier: Apache-2.0
// recording.json of a scene bundle: parses any bytes, and writes what it read unchanged, or throws
// an InputError.
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/recording_json.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = [](std::string_view text) {
    return redrive::recording_to_json(redrive::parse_recording_json(text, "recording.json"));
  };
  try {
    const std::string text = read({reinterpret_cast<const char*>(data), size});
    if (read(text) != text) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
