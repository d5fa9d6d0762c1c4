// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_write.h"

#include <cstdio>
#include <ctime>

#include "redrive/base/error.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive::kitti {

std::string make_scan(std::span<const LidarRecord> points) {
  std::string bytes;
  for (const LidarRecord& point : points) {
    for (const double coordinate : point.position_m)
      add_bytes(static_cast<float>(coordinate), &bytes);
    add_bytes(point.intensity, &bytes);
  }
  return bytes;
}

std::string make_timestamp(std::int64_t t_ns) {
  constexpr std::int64_t kSecond_ns = 1'000'000'000;
  const std::int64_t fraction_ns = (t_ns % kSecond_ns + kSecond_ns) % kSecond_ns;
  const std::time_t seconds = (t_ns - fraction_ns) / kSecond_ns;
  std::tm day{};
  ::gmtime_r(&seconds, &day);
  char text[64];
  const std::size_t length = std::strftime(text, sizeof text, "%Y-%m-%d %H:%M:%S", &day);
  std::snprintf(text + length, sizeof text - length, ".%09d", static_cast<int>(fraction_ns));
  return text;
}

std::string make_timestamps(const std::vector<std::pair<std::int64_t, std::int64_t>>& times) {
  std::string text;
  std::int64_t next = 0;
  for (const auto& [frame_id, t_ns] : times) {
    REDRIVE_CHECK_OP(next, <=, frame_id);
    text.append(static_cast<std::size_t>(frame_id - next), '\n');
    text += make_timestamp(t_ns) + "\n";
    next = frame_id + 1;
  }
  return text;
}

std::string file_name(std::int64_t frame_id, const char* extension) {
  char name[40];
  std::snprintf(name, sizeof name, "%010lld%s", static_cast<long long>(frame_id), extension);
  return name;
}

}  // namespace redrive::kitti
