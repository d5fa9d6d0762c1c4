// SPDX-License-Identifier: Apache-2.0
// A packet of the GPS and IMU of KITTI: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto check = [](const redrive::Rigid3d& pose) {
    if (!redrive::rigid_obstacle(pose.matrix()).empty() || !(pose.translation().norm() < 1e7))
      __builtin_trap();
  };
  try {
    std::vector<redrive::DamagedRecord> records;
    const redrive::DamagedList damaged{"poses", &records};
    for (const auto& pose : redrive::kitti::parse_oxts_lines(text, "0.txt", &damaged))
      if (pose) check(*pose);
    check(redrive::kitti::parse_oxts(text, "0.txt"));
  } catch (const redrive::InputError&) {
  }
  return 0;
}
