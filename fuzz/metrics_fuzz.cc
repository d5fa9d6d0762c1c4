// SPDX-License-Identifier: Apache-2.0
// metrics.jsonl: parses any bytes or throws an InputError. The part that resume keeps is valid.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/train/run.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  const std::string kept = redrive::truncated_metrics(bytes, {1, 1, 50});
  redrive::parse_metrics(kept, "kept");
  if (redrive::truncated_metrics(kept, {1, 1, 50}) != kept) __builtin_trap();
  try {
    redrive::parse_metrics(bytes, "metrics.jsonl");
  } catch (const redrive::InputError&) {
  }
  return 0;
}
