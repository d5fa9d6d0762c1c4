// SPDX-License-Identifier: Apache-2.0
// checkpoint.safetensors: parses any bytes, and writes them back unchanged, or throws an
// InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/train/files/state.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const redrive::TrainState state = redrive::parse_checkpoint(
        {reinterpret_cast<const char*>(data), size}, "checkpoint.safetensors");
    const std::string bytes = redrive::checkpoint_bytes(state);
    if (redrive::checkpoint_bytes(redrive::parse_checkpoint(bytes, "again")) != bytes)
      __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
