// SPDX-License-Identifier: Apache-2.0
// Revolutions of nuScenes: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    constexpr std::int64_t kEnd_ns = 100'000'000;
    const std::vector<redrive::FramePose> poses = {{0, 0, redrive::Rigid3d::Identity()}};
    // The interval of two scans is known or not.
    const redrive::nuscenes::Spin spin =
        redrive::nuscenes::spin_of(text, "0.pcd.bin", size % 3 == 0 ? 0 : 60'000'000);
    for (const redrive::LidarPoint& point : redrive::nuscenes::parse_scan(
             text, "0.pcd.bin", {redrive::Rigid3d::Identity(), kEnd_ns, spin}, poses))
      if (!(point.in_body_m.cwiseAbs().maxCoeff() <= 1000) || point.intensity > 255 ||
          point.t_ns < kEnd_ns - 100'000'000 || point.t_ns > kEnd_ns)
        __builtin_trap();
  } catch (const redrive::InputError&) {
  }
  return 0;
}
