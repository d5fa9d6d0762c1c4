// SPDX-License-Identifier: Apache-2.0
// POSES.json: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/edit/view_requests.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    for (const redrive::RequestedView& view :
         redrive::parse_view_requests(text, "poses.json").views) {
      if (view.file.empty() || view.file.front() == '/' ||
          (!view.global_from_body && !view.shift_body_m))
        __builtin_trap();
    }
  } catch (const redrive::InputError&) {
  }
  return 0;
}
