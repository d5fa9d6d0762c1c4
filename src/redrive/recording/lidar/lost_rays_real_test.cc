// SPDX-License-Identifier: Apache-2.0
// Lost rays of real recordings; skipped where these are missing.
#include <filesystem>

#include <gtest/gtest.h>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/lost_rays.h"

namespace redrive {
namespace {

struct Rays {
  double fired = 0, lost_share = 0;  // the mean over scans
};

std::vector<Rays> rays_of(const std::filesystem::path& root) {
  constexpr std::size_t kScans = 5;
  std::vector<Rays> rays;
  const Recording recording = open_recording(root);
  for (std::size_t i = 0; i < kScans; ++i) {
    const std::vector<std::vector<LidarPoint>> scan = {recording.reader->read_lidar(
        recording.lidar_files[i * (recording.lidar_files.size() - 1) / (kScans - 1)])};
    std::string why;
    const auto structure = estimate_structure(scan, recording.lidars[0].body_from_lidar, &why);
    EXPECT_TRUE(structure) << why;
    if (!structure) continue;
    const LostRays lost = lost_rays(scan[0], recording.lidars[0].body_from_lidar, *structure, &why);
    EXPECT_EQ(why, "");
    const auto fired = static_cast<double>(lost.size() + lost.returned);
    rays.push_back({fired, static_cast<double>(lost.size()) / fired});
  }
  return rays;
}

// An HDL-64E: a cycle of 64 lasers takes 48 us, a turn 103.5 ms.
TEST(LostRaysReal, OfKitti) {
  for (const char* const drive : {"0002", "0013"}) {
    const std::filesystem::path root =
        REDRIVE_SHARED "/data/kitti/2011_09_26/2011_09_26_drive_" + std::string(drive) + "_sync";
    if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
    for (const auto& [fired, lost_share] : rays_of(root)) {
      EXPECT_NEAR(fired, 64 * 2155, 64 * 20) << drive;
      EXPECT_GT(lost_share, 0.1) << drive;
      EXPECT_LT(lost_share, 0.2) << drive;
    }
  }
}

// A Pandar64, whose beams above the road see the night sky.
TEST(LostRaysReal, OfTheNight) {
  const std::filesystem::path root = REDRIVE_SHARED "/data/aimotive_night";
  if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
  for (const auto& [fired, lost_share] : rays_of(root)) {
    EXPECT_NEAR(fired, 64 * 1806, 64 * 6);
    EXPECT_GT(lost_share, 0.08);
    EXPECT_LT(lost_share, 0.15);
  }
}

}  // namespace
}  // namespace redrive
