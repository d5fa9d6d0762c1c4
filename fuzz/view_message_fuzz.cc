// SPDX-License-Identifier: Apache-2.0
// Messages of the viewer's page: parses any bytes or throws an InputError.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/view/server/messages.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    const redrive::view::ClientMessage message = redrive::view::parse_client_message(text);
    if (const auto* const view = std::get_if<redrive::view::ViewRequest>(&message))
      for (const double shift_m : view->shift_m)
        if (!(std::abs(shift_m) <= 1e4) || !(std::abs(view->yaw_deg) <= 360)) __builtin_trap();
    if (const auto* const view = std::get_if<redrive::view::ViewRequest>(&message);
        view && view->mount) {
      const redrive::Lens& lens = view->mount->lens;
      if (lens.camera.empty() &&
          (lens.width > 4096 || lens.height > 4096 || !(lens.pinhole().fx > 0)))
        __builtin_trap();
    }
    if (const auto* const pick = std::get_if<redrive::view::Pick>(&message))
      if (!(pick->u >= 0 && pick->u <= 1 && pick->v >= 0 && pick->v <= 1)) __builtin_trap();
    if (const auto* const path = std::get_if<redrive::view::PathMessage>(&message))
      if (path->keyframes.empty() ||
          (path->save && !redrive::view::valid_path_name(path->save->name)))
        __builtin_trap();
    if (const auto* const load = std::get_if<redrive::view::LoadPath>(&message))
      if (!redrive::view::valid_path_name(load->name)) __builtin_trap();
    if (const auto* const drag = std::get_if<redrive::view::DragMessage>(&message))
      for (const double u : {drag->from[0], drag->from[1], drag->to[0], drag->to[1]})
        if (!(u >= 0 && u <= 1) || !(std::abs(drag->turn_deg) <= 360)) __builtin_trap();
    if (const auto* const edit = std::get_if<redrive::view::EditMessage>(&message))
      if (edit->file.size() > 256) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
