// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_write.h"

#include <gtest/gtest.h>

#include "redrive/recording/formats/kitti/kitti_poses.h"
#include "redrive/recording/formats/kitti/kitti_scan.h"

namespace redrive::kitti {
namespace {

const std::vector<LidarRecord> kPoints = {{{1.5, -2.25, 0.125}, 4'800'000'000'000, 0.25f},
                                          {{-31.0626, 8.4, -1.7}, 4'800'000'512'000, 1},
                                          {{250, 0, 12.0001}, 4'800'100'000'000, 0}};

TEST(KittiWrite, AScanIsReadBack) {
  const auto points = parse_scan(make_scan(kPoints), "0.bin", Rigid3d::Identity(), {0, 0});
  ASSERT_EQ(points.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(points[i].in_body_m, kPoints[i].position_m.cast<float>());
    EXPECT_EQ(points[i].intensity, std::lround(65535 * kPoints[i].intensity));
  }
}

TEST(KittiWrite, TimestampsAreReadBack) {
  const std::int64_t t_ns = 1'317'042'651'175'862'102;
  EXPECT_EQ(make_timestamp(t_ns), "2011-09-26 13:10:51.175862102");
  const auto times = parse_timestamps(make_timestamp(t_ns) + "\n", "timestamps.txt");
  ASSERT_EQ(times.size(), 1u);
  EXPECT_EQ(times[0], t_ns);
  EXPECT_EQ(make_timestamp(-1), "1969-12-31 23:59:59.999999999");
}

TEST(KittiWrite, FilesOfTimesHaveALineForEveryFrame) {
  const std::int64_t second_ns = 1'000'000'000;
  const std::string text = make_timestamps({{1, second_ns}, {4, 2 * second_ns + 7}});
  const auto times = parse_timestamps(text, "timestamps.txt");
  ASSERT_EQ(times.size(), 5u);
  for (const std::size_t frame : {0, 2, 3}) EXPECT_FALSE(times[frame]) << frame;
  EXPECT_EQ(times[1], second_ns);
  EXPECT_EQ(times[4], 2 * second_ns + 7);
  EXPECT_EQ(make_timestamps({}), "");
  EXPECT_EQ(file_name(12, ".bin"), "0000000012.bin");
}

}  // namespace
}  // namespace redrive::kitti
