// SPDX-License-Identifier: Apache-2.0
// Pickled tables, as scans and as cuboids of PandaSet: parses any bytes or throws an InputError.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/pandaset/pandaset_boxes.h"
#include "redrive/recording/formats/pandaset/pandaset_scan.h"
#include "redrive/recording/parse/data_frame.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  try {
    redrive::DataFrame(bytes, "t.pkl");
    std::vector<std::string> impossible;
    for (const redrive::pandaset::Cuboid& cuboid :
         redrive::pandaset::parse_cuboids(bytes, "t.pkl", &impossible))
      if (!(cuboid.size_m.minCoeff() > 0) || cuboid.uuid.empty()) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  try {
    const std::vector<redrive::FramePose> poses = {{0, 0, redrive::Rigid3d::Identity()}};
    for (const redrive::LidarPoint& point : redrive::pandaset::parse_scan(
             bytes, "t.pkl", redrive::pandaset::Lidar::kPandar64, poses, poses[0].global_from_body))
      if (!(point.in_body_m.norm() <= 1001) || point.intensity > 255) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
