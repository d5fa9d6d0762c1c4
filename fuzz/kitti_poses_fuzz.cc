// SPDX-License-Identifier: Apache-2.0
// Poses of the odometry benchmark of KITTI and of KITTI-360: parses any bytes or throws an
// InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  std::vector<redrive::DamagedRecord> records;
  const redrive::DamagedList damaged{"poses", &records};
  try {
    for (const auto& pose : redrive::kitti::parse_poses(text, "00.txt", &damaged))
      if (pose && !redrive::rigid_obstacle(pose->matrix()).empty()) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  try {
    for (const redrive::FramePose& frame :
         redrive::kitti::parse_frame_poses(text, "poses.txt", &damaged))
      if (!redrive::rigid_obstacle(frame.global_from_body.matrix()).empty() || frame.id < 0)
        __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
