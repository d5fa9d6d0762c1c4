// SPDX-License-Identifier: Apache-2.0
// Moving objects of a run: parses any bytes or throws an InputError.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/perception/moving_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    for (const redrive::MovingObject& object : redrive::parse_moving_objects(text, "moving.json")) {
      if (object.keys.empty() || !(object.size_m.minCoeff() >= 0)) __builtin_trap();
      for (std::size_t k = 0; k < object.keys.size(); ++k) {
        if (k > 0 && object.keys[k].t_ns <= object.keys[k - 1].t_ns) __builtin_trap();
        const auto pose = object.world_from_box(object.keys[k].t_ns);
        if (!pose || !std::isfinite(pose->translation().norm())) __builtin_trap();
        if (!std::isfinite(object.keys[k].velocity_in_world_m_per_s.norm())) __builtin_trap();
      }
    }
  } catch (const redrive::InputError&) {
  }
  return 0;
}
