// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/scan_files.h"

#include <cstdlib>
#include <fstream>

#include <gmock/gmock.h>

#include "redrive/base/temporary_folder_testing.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"
#include "redrive/recording/formats/kitti/kitti_scan.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

const std::vector<LidarRecord> kPoints = {{{1.5, -2.25, 0.125}, 4'800'000'000'000, 7},
                                          {{-31.0626, 8.4, -1.7}, 4'800'000'512'000, 65535},
                                          {{250, 0, 12.0001}, 4'800'100'000'000, 0}};

TEST(ScanFiles, LasIsReadBackByTheReaderOfRevolutions) {
  const std::vector<LidarPoint> points = parse_las(make_las(kPoints), "made.las");
  ASSERT_EQ(points.size(), kPoints.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_LT((points[i].in_body_m.cast<double>() - kPoints[i].position_m).norm(), 1e-4) << i;
    EXPECT_EQ(points[i].t_ns, kPoints[i].t_ns);
    EXPECT_EQ(points[i].intensity, kPoints[i].intensity);
  }
  EXPECT_TRUE(parse_las(make_las(std::span<const LidarRecord>()), "empty.las").empty());
}

TEST(ScanFiles, LasHeaderHasBoundsAndCounts) {
  const std::string bytes = make_las(kPoints);
  EXPECT_EQ(bytes.size(), 227u + 28 * 3);
  EXPECT_EQ(little_endian<std::uint32_t>(bytes, 111), 3u) << "first returns";
  const double bounds[] = {250, -31.0626, 8.4, -2.25, 12.0001, -1.7};
  for (std::size_t i = 0; i < 6; ++i)
    EXPECT_EQ(little_endian<double>(bytes, 179 + 8 * i), bounds[i]) << i;
}

TEST(ScanFiles, PcdHasItsHeaderAndAsManyBytesAsItSays) {
  const std::string bytes = make_pcd(kPoints), head = "DATA binary\n";
  const std::size_t data = bytes.find(head) + head.size();
  EXPECT_THAT(bytes.substr(0, data), HasSubstr("\nFIELDS x y z time\nSIZE 4 4 4 8\n"));
  EXPECT_THAT(bytes.substr(0, data), HasSubstr("\nPOINTS 3\n"));
  ASSERT_EQ(bytes.size() - data, 3u * 20);
  EXPECT_EQ(little_endian<float>(bytes, data + 20), -31.0626f);
  EXPECT_NEAR(little_endian<double>(bytes, data + 32), 4800.000512, 1e-9);
}

TEST(ScanFiles, KittiScanIsReadBack) {
  const auto points =
      kitti::parse_scan(make_kitti_scan(kPoints), "0.bin", Rigid3d::Identity(), {0, 0});
  ASSERT_EQ(points.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(points[i].in_body_m, kPoints[i].position_m.cast<float>());
    EXPECT_EQ(points[i].intensity, 0);
  }
}

TEST(ScanFiles, TimestampsAreReadBack) {
  const std::int64_t t_ns = 1'317'042'651'175'862'102;
  EXPECT_EQ(kitti_timestamp(t_ns), "2011-09-26 13:10:51.175862102");
  const auto times = kitti::parse_timestamps(kitti_timestamp(t_ns) + "\n", "timestamps.txt");
  ASSERT_EQ(times.size(), 1u);
  EXPECT_EQ(times[0], t_ns);
  EXPECT_EQ(kitti_timestamp(-1), "1969-12-31 23:59:59.999999999");
}

TEST(ScanFiles, FilesOfTimesHaveALineForEveryFrame) {
  const std::int64_t second_ns = 1'000'000'000;
  const std::string text = kitti_timestamps({{1, second_ns}, {4, 2 * second_ns + 7}});
  const auto times = kitti::parse_timestamps(text, "timestamps.txt");
  ASSERT_EQ(times.size(), 5u);
  for (const std::size_t frame : {0, 2, 3}) EXPECT_FALSE(times[frame]) << frame;
  EXPECT_EQ(times[1], second_ns);
  EXPECT_EQ(times[4], 2 * second_ns + 7);
  EXPECT_EQ(kitti_timestamps({}), "");
  EXPECT_EQ(kitti_file_name(12, ".bin"), "0000000012.bin");
}

/// Expects that a program of others accepts a file and prints `expected`; skips where it is
/// missing.
void expect_accepted(const char* program, const std::string& command, const char* expected) {
  if (std::system((std::string("command -v ") + program + " >/dev/null").c_str()) != 0)
    GTEST_SKIP() << "there is no " << program;
  FILE* const pipe = popen((command + " 2>&1").c_str(), "r");
  std::string text;
  for (int c = std::fgetc(pipe); c != EOF; c = std::fgetc(pipe)) text += static_cast<char>(c);
  EXPECT_EQ(pclose(pipe), 0) << text;
  EXPECT_THAT(text, HasSubstr(expected));
}

TEST(ScanFiles, PdalReadsTheLas) {
  const TemporaryFolder folder;
  folder.write("a.las", make_las(kPoints));
  expect_accepted("pdal", "pdal info --summary " + (folder.path / "a.las").string(),
                  "\"num_points\": 3");
}

TEST(ScanFiles, PclReadsThePcd) {
  const TemporaryFolder folder;
  folder.write("a.pcd", make_pcd(kPoints));
  const std::string in = (folder.path / "a.pcd").string(), out = (folder.path / "b.pcd").string();
  expect_accepted("pcl_convert_pcd_ascii_binary",
                  "pcl_convert_pcd_ascii_binary " + in + " " + out + " 0 && cat " + out, "-31.062");
}

}  // namespace
}  // namespace redrive
