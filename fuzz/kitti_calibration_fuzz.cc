// SPDX-License-Identifier: Apache-2.0
// Calibration files of KITTI: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/kitti/kitti_calibration.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto attempt = [](auto&& parse) {
    try {
      parse();
    } catch (const redrive::InputError&) {
    }
  };
  attempt([&] {
    for (const auto& [number, camera] : redrive::kitti::parse_cam_to_cam(text, "a.txt").cameras)
      if (!(camera.fx > 0) || !camera.size) __builtin_trap();
  });
  attempt([&] { redrive::kitti::parse_odometry_calibration(text, "a.txt"); });
  attempt([&] { redrive::kitti::parse_tracking_calibration(text, "a.txt"); });
  attempt([&] {
    if (!redrive::rigid_obstacle(redrive::kitti::parse_rigid(text, "a.txt").matrix()).empty())
      __builtin_trap();
  });
  return 0;
}
