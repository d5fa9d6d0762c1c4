// SPDX-License-Identifier: Apache-2.0
// Calibration files of KITTI-360: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/kitti360/kitti360_calibration.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto attempt = [](auto&& parse) {
    try {
      parse();
    } catch (const redrive::InputError&) {
    }
  };
  attempt([&] {
    for (const auto& [number, camera] : redrive::kitti360::parse_perspective(text, "a.txt"))
      if (!(camera.projection.fx > 0) || !camera.projection.size) __builtin_trap();
  });
  attempt([&] {
    const redrive::CameraCalibration camera =
        redrive::kitti360::parse_fisheye(text, "image_02.yaml");
    if (!(camera.fx() > 0) || camera.parameters.size() != 10) __builtin_trap();
  });
  attempt([&] {
    for (const auto& [name, pose] : redrive::kitti360::parse_cam_to_pose(text, "a.txt"))
      if (!redrive::rigid_obstacle(pose.matrix()).empty()) __builtin_trap();
  });
  attempt([&] { redrive::kitti360::parse_cam_to_velo(text, "a.txt"); });
  return 0;
}
