// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/pcd.h"

#include <cstdlib>
#include <fstream>

#include <gmock/gmock.h>

#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

const std::vector<LidarRecord> kPoints = {{{1.5, -2.25, 0.125}, 4'800'000'000'000, 7},
                                          {{-31.0626, 8.4, -1.7}, 4'800'000'512'000, 65535},
                                          {{250, 0, 12.0001}, 4'800'100'000'000, 0}};

TEST(WrittenFiles, LasIsReadBackByTheReaderOfRevolutions) {
  const std::vector<LidarPoint> points = parse_las(make_las(kPoints), "made.las");
  ASSERT_EQ(points.size(), kPoints.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_LT((points[i].in_body_m.cast<double>() - kPoints[i].position_m).norm(), 1e-4) << i;
    EXPECT_EQ(points[i].t_ns, kPoints[i].t_ns);
    EXPECT_EQ(points[i].intensity, kPoints[i].intensity);
  }
  EXPECT_TRUE(parse_las(make_las(std::span<const LidarRecord>()), "empty.las").empty());
}

TEST(WrittenFiles, LasHeaderHasBoundsAndCounts) {
  const std::string bytes = make_las(kPoints);
  EXPECT_EQ(bytes.size(), 227u + 28 * 3);
  EXPECT_EQ(little_endian<std::uint32_t>(bytes, 111), 3u) << "first returns";
  const double bounds[] = {250, -31.0626, 8.4, -2.25, 12.0001, -1.7};
  for (std::size_t i = 0; i < 6; ++i)
    EXPECT_EQ(little_endian<double>(bytes, 179 + 8 * i), bounds[i]) << i;
}

TEST(WrittenFiles, PcdHasItsHeaderAndAsManyBytesAsItSays) {
  const std::string bytes = make_pcd(kPoints), head = "DATA binary\n";
  const std::size_t data = bytes.find(head) + head.size();
  EXPECT_THAT(bytes.substr(0, data), HasSubstr("\nFIELDS x y z time\nSIZE 4 4 4 8\n"));
  EXPECT_THAT(bytes.substr(0, data), HasSubstr("\nPOINTS 3\n"));
  ASSERT_EQ(bytes.size() - data, 3u * 20);
  EXPECT_EQ(little_endian<float>(bytes, data + 20), -31.0626f);
  EXPECT_NEAR(little_endian<double>(bytes, data + 32), 4800.000512, 1e-9);
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

TEST(WrittenFiles, PdalReadsTheLas) {
  const TemporaryFolder folder;
  folder.write("a.las", make_las(kPoints));
  expect_accepted("pdal", "pdal info --summary " + (folder.path / "a.las").string(),
                  "\"num_points\": 3");
}

TEST(WrittenFiles, PclReadsThePcd) {
  const TemporaryFolder folder;
  folder.write("a.pcd", make_pcd(kPoints));
  const std::string in = (folder.path / "a.pcd").string(), out = (folder.path / "b.pcd").string();
  expect_accepted("pcl_convert_pcd_ascii_binary",
                  "pcl_convert_pcd_ascii_binary " + in + " " + out + " 0 && cat " + out, "-31.062");
}

}  // namespace
}  // namespace redrive
