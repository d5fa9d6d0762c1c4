// SPDX-License-Identifier: Apache-2.0
// Velodyne scans of KITTI: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/kitti/kitti_scan.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    const redrive::kitti::ScanTime time{1'000, 2'000};
    for (const redrive::LidarPoint& point :
         redrive::kitti::parse_scan(text, "0.bin", redrive::Rigid3d::Identity(), time))
      if (!(point.in_body_m.cwiseAbs().maxCoeff() <= 1000) || point.t_ns < time.start_ns ||
          point.t_ns > time.end_ns)
        __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
