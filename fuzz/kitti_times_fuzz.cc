// SPDX-License-Identifier: Apache-2.0
// Times of KITTI: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  std::vector<redrive::DamagedRecord> records;
  const redrive::DamagedList damaged{"times", &records};
  const auto check = [](const std::vector<std::optional<std::int64_t>>& times) {
    std::optional<std::int64_t> before;
    for (const auto& t_ns : times) {
      if (t_ns && before && *t_ns <= *before) __builtin_trap();
      if (t_ns) before = t_ns;
    }
  };
  try {
    check(redrive::kitti::parse_timestamps(text, "timestamps.txt", &damaged));
  } catch (const redrive::InputError&) {
  }
  try {
    check(redrive::kitti::parse_times(text, "times.txt", &damaged));
  } catch (const redrive::InputError&) {
  }
  return 0;
}
