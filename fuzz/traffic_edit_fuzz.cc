// SPDX-License-Identifier: Apache-2.0
// Changes to moving objects: parses any bytes or throws an InputError.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/edit/traffic_edit.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto check = [](const redrive::ActorChange& change) {
    if (!(change.speed >= 0) || change.track.size() == 1) __builtin_trap();
    if (change.hide_s && !((*change.hide_s)[0] < (*change.hide_s)[1])) __builtin_trap();
    for (std::size_t i = 1; i < change.track.size(); ++i)
      if (!(change.track[i].time_s > change.track[i - 1].time_s)) __builtin_trap();
    for (const auto& shift : {change.shift_m, change.shift_road_m})
      for (const double shift_m : shift)
        if (!std::isfinite(shift_m)) __builtin_trap();
    if (change.body && !change.body_file.empty()) __builtin_trap();
  };
  try {
    const redrive::TrafficEdit edit = redrive::parse_traffic_edit(text, "edit.json");
    for (const auto& [id, change] : edit.actors) check(change);
    for (const redrive::ActorCopy& copy : edit.copies) check(copy.change);
    for (const redrive::AddedActor& added : edit.added) {
      check(added.change);
      if (added.change.track.empty() || added.change.body_file.empty()) __builtin_trap();
    }
  } catch (const redrive::InputError&) {
  }
  return 0;
}
