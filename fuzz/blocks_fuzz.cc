// SPDX-License-Identifier: Apache-2.0
// blocks.json: parses any bytes, and writes them back unchanged, or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/train/files/blocks.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const auto blocks = redrive::parse_blocks(
        std::string_view(reinterpret_cast<const char*>(data), size), "blocks.json");
    const std::string text = redrive::blocks_text(blocks);
    if (redrive::blocks_text(redrive::parse_blocks(text, "blocks.json")) != text) __builtin_trap();
    for (const redrive::Block& block : blocks)
      if (redrive::block_folder("run", block).parent_path() != "run/blocks") __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
