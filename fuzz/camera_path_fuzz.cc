// SPDX-License-Identifier: Apache-2.0
// Camera paths: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/edit/camera_path_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    const redrive::CameraPathFile path = redrive::parse_camera_path(text, "path.json");
    if (path.cameras.empty() == path.keyframes.empty() || !(path.seconds >= 0) ||
        !(path.fps >= 1 && path.fps <= 240))
      __builtin_trap();
    for (const redrive::PathCamera& camera : path.cameras)
      if (!camera.world_from_camera.matrix().allFinite() || path.width < 2 || path.height < 2)
        __builtin_trap();
    for (std::size_t i = 1; i < path.keyframes.size(); ++i)
      if (!(path.keyframes[i].time_s > path.keyframes[i - 1].time_s)) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
