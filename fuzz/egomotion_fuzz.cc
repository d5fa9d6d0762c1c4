// SPDX-License-Identifier: Apache-2.0
// egomotion2.json: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/egomotion_json.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    std::vector<redrive::DamagedRecord> records;
    const redrive::DamagedList damaged{"poses", &records};
    for (const redrive::FramePose& frame :
         redrive::parse_egomotion(text, "egomotion2.json", &damaged)) {
      if (!frame.global_from_body.matrix().allFinite()) __builtin_trap();
    }
  } catch (const redrive::InputError&) {
  }
  return 0;
}
