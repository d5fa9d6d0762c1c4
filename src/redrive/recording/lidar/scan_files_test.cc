// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/scan_files.h"

#include <cstdlib>
#include <fstream>

#include <gmock/gmock.h>

#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/lidar/ply.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

const std::vector<LidarRecord> kPoints = {
    {{1.5, -2.25, 0.125}, 4'800'000'000'000, 7.0f / 65535},
    {{-31.0626, 8.4, -1.7}, 4'800'000'512'000, 1, 3, -2.5f, 32.2f, -1, 0.25f},
    {{250, 0, 12.0001}, 4'800'100'000'000, 0}};

/// The fields of the second point of PCD and PLY.
void expect_second_point(const std::string& bytes) {
  EXPECT_EQ(little_endian<float>(bytes, 0), -31.0626f);
  EXPECT_EQ(little_endian<float>(bytes, 12), 1);
  EXPECT_EQ(bytes[16], 3);
  EXPECT_NEAR(little_endian<double>(bytes, 17), 4800.000512, 1e-9);
  EXPECT_EQ(little_endian<float>(bytes, 25), 32.2f);
  EXPECT_EQ(little_endian<float>(bytes, 29), -2.5f);
  EXPECT_EQ(little_endian<std::int32_t>(bytes, 33), -1);
  EXPECT_EQ(little_endian<float>(bytes, 37), 0.25f);
}

TEST(WrittenFiles, LasIsReadBackByTheReaderOfRevolutions) {
  const std::vector<LidarPoint> points = parse_las(make_las(kPoints), "made.las");
  ASSERT_EQ(points.size(), kPoints.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_LT((points[i].in_body_m.cast<double>() - kPoints[i].position_m).norm(), 1e-4) << i;
    EXPECT_EQ(points[i].t_ns, kPoints[i].t_ns);
    EXPECT_EQ(points[i].intensity, std::lround(65535 * kPoints[i].intensity));
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

TEST(WrittenFiles, LasMayHaveAllFieldsAsExtraBytes) {
  const std::string bytes = make_las(kPoints, 1e-4, LasFields::kAll);
  const auto begin = little_endian<std::uint32_t>(bytes, 96);
  EXPECT_EQ(little_endian<std::uint32_t>(bytes, 100), 1u) << "variable length records";
  EXPECT_EQ(begin, 227u + 54 + 5 * 192);
  EXPECT_STREQ(&bytes[227 + 2], "LASF_Spec");
  EXPECT_EQ(little_endian<std::uint16_t>(bytes, 227 + 18), 4) << "extra bytes";
  EXPECT_EQ(little_endian<std::uint16_t>(bytes, 227 + 20), 5 * 192) << "bytes after the header";
  const char* const names[] = {"ring", "azimuth", "range", "actor", "loss"};
  const int types[] = {1, 9, 9, 6, 9};
  for (std::size_t i = 0; i < 5; ++i) {
    const std::size_t at = 227 + 54 + 192 * i;
    EXPECT_EQ(bytes[at + 2], types[i]);
    EXPECT_STREQ(&bytes[at + 4], names[i]);
  }
  EXPECT_EQ(bytes[227 + 54 + 192 * 3 + 3], 1) << "has a value without data";
  EXPECT_EQ(little_endian<std::int64_t>(bytes, 227 + 54 + 192 * 3 + 40), kNoActor);
  const std::size_t record = little_endian<std::uint16_t>(bytes, 105);
  ASSERT_EQ(record, 28u + 17);
  ASSERT_EQ(bytes.size(), begin + 3 * record);
  const std::size_t extra = begin + record + 28;
  EXPECT_EQ(bytes[extra], 3);
  EXPECT_EQ(little_endian<float>(bytes, extra + 1), -2.5f);
  EXPECT_EQ(little_endian<float>(bytes, extra + 5), 32.2f);
  EXPECT_EQ(little_endian<std::int32_t>(bytes, extra + 9), -1);
  EXPECT_EQ(little_endian<float>(bytes, extra + 13), 0.25f);
  const std::vector<LidarPoint> points = parse_las(bytes, "made.las");
  ASSERT_EQ(points.size(), 3u);
  EXPECT_EQ(points[1].t_ns, kPoints[1].t_ns);
}

TEST(WrittenFiles, PlyHasAllFields) {
  const std::string bytes = make_scan_ply(kPoints), head = "end_header\n";
  const std::size_t data = bytes.find(head) + head.size();
  EXPECT_THAT(bytes.substr(0, data), HasSubstr("property int actor\nproperty float loss\n"));
  ASSERT_EQ(bytes.size() - data, 3u * 41);
  expect_second_point(bytes.substr(data + 41));
  EXPECT_EQ(parse_ply(bytes, "made.ply").size(), 3u);
}

TEST(WrittenFiles, PcdHasItsHeaderAndAsManyBytesAsItSays) {
  const std::string bytes = make_pcd(kPoints), head = "DATA binary\n";
  const std::size_t data = bytes.find(head) + head.size();
  EXPECT_THAT(bytes.substr(0, data),
              HasSubstr("\nFIELDS x y z intensity ring time range azimuth actor loss\n"
                        "SIZE 4 4 4 4 1 8 4 4 4 4\n"
                        "TYPE F F F F U F F F I F\n"));
  EXPECT_THAT(bytes.substr(0, data), HasSubstr("\nPOINTS 3\n"));
  ASSERT_EQ(bytes.size() - data, 3u * 41);
  expect_second_point(bytes.substr(data + 41));
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
