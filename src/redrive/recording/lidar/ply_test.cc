// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/ply.h"

#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/lidar/las_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using testing::append;
using ::testing::HasSubstr;
using testing::input_error;

std::string header(const std::string& format, const std::string& vertices,
                   const std::string& properties) {
  return "ply\nformat " + format + " 1.0\ncomment made by hand\nelement vertex " + vertices + "\n" +
         properties + "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
}
const std::string kXyz = "property float x\nproperty float y\nproperty float z\n";

std::string message(const std::string& bytes) {
  const std::string text = input_error([&] { parse_ply(bytes, "dir/points.ply"); });
  EXPECT_THAT(text, HasSubstr("dir/points.ply"));
  return text;
}

TEST(Ply, ReadsAscii) {
  const std::string bytes =
      header("ascii", "2",
             "property double y\nproperty uchar red\nproperty float x\nproperty double z\n") +
      "2.5 255 1 -3e2\r\n  0 0\t-7 0.125\n3 0 1 0\n";
  const auto points = parse_ply(bytes, "points.ply");
  ASSERT_EQ(points.size(), 2u);
  EXPECT_EQ(points[0], Eigen::Vector3d(1, 2.5, -300));
  EXPECT_EQ(points[1], Eigen::Vector3d(-7, 0, 0.125));
}

TEST(Ply, ReadsBinaryLittleEndian) {
  std::string bytes =
      header("binary_little_endian", "2",
             "property float x\nproperty ushort ring\nproperty double y\nproperty float z\n");
  for (const int i : {1, 2}) {
    append(&bytes, 0.5f * i), append(&bytes, std::uint16_t{9}), append(&bytes, 1.0 / i),
        append(&bytes, -2.0f * i);
  }
  const auto points = parse_ply(bytes + "faces", "points.ply");
  ASSERT_EQ(points.size(), 2u);
  EXPECT_EQ(points[0], Eigen::Vector3d(0.5, 1, -2));
  EXPECT_EQ(points[1], Eigen::Vector3d(1, 0.5, -4));
}

TEST(Ply, LeavesOutPointsThatAreNotFinite) {
  std::size_t left_out = 0;
  const auto points =
      parse_ply(header("ascii", "4", kXyz) + "1 2 nan\n1 2 3\ninf 0 0\n6000000 0 0\n", "points.ply",
                &left_out);
  ASSERT_EQ(points.size(), 2u);
  EXPECT_EQ(points[1], Eigen::Vector3d(6e6, 0, 0));
  EXPECT_EQ(left_out, 2u);
}

TEST(Ply, ReadsBigEndianBehindOtherElements) {
  const std::string elements =
      "element face 2\nproperty list uchar int vertex_indices\nproperty short kind\n"
      "element vertex 1\n" +
      kXyz + "end_header\n";
  std::string bytes = "ply\nformat binary_big_endian 1.0\n" + elements;
  bytes += std::string("\x01....kk", 7) + std::string("\x00kk", 3);
  for (const float value : {1.0f, -2.0f, 0.5f}) {
    std::string little;
    append(&little, value);
    bytes.append(little.rbegin(), little.rend());
  }
  EXPECT_EQ(parse_ply(bytes, "a.ply"), std::vector{Eigen::Vector3d(1, -2, 0.5)});
  EXPECT_EQ(parse_ply("ply\nformat ascii 1.0\n" + elements + "3 0 1 2 7\n0 7\n1 -2 0.5\n", "a.ply"),
            std::vector{Eigen::Vector3d(1, -2, 0.5)});
}

// UTM and ECEF have coordinates of millions of metres, of which floats resolve half a metre.
TEST(Ply, KeepsMillimetresFarFromTheOrigin) {
  const Eigen::Vector3d origin(691'000.25, 5'335'000.5, -9'000'000);
  std::vector<PlyPoint> points(2);
  points[0].position = {0.001f, -2.002f, 3.5f};
  points[1].position = {900.125f, 0, -7};
  for (const bool normals : {false, true}) {
    const std::vector<Eigen::Vector3d> back =
        parse_ply(make_ply(points, normals, {}, origin), "a.ply");
    ASSERT_EQ(back.size(), 2u);
    for (std::size_t i = 0; i < 2; ++i)
      EXPECT_LT((back[i] - origin - points[i].position.cast<double>()).norm(), 1e-8) << i;
  }
}

TEST(Ply, RejectsInvalidFiles) {
  EXPECT_THAT(message("solid\n"), HasSubstr("ply"));
  EXPECT_THAT(message("ply\nformat ascii 1.0\n"), HasSubstr("truncated"));
  EXPECT_THAT(message(header("binary_middle_endian", "0", kXyz)), HasSubstr("binary_big_endian"));
  EXPECT_THAT(message(header("ascii", "-1", kXyz)), HasSubstr("number of points"));
  EXPECT_THAT(message(header("ascii", "100000001", kXyz)), HasSubstr("up to 100000000"));
  EXPECT_THAT(message(header("ascii", "0", "property float x\nproperty float y\n")),
              AllOf(HasSubstr("z"), HasSubstr("missing")));
  EXPECT_THAT(message(header("ascii", "0", kXyz + "property float x\n")), HasSubstr("twice"));
  EXPECT_THAT(message(header("ascii", "0", "property int x\n")), HasSubstr("float or double"));
  EXPECT_THAT(message(header("ascii", "0", kXyz + "property list uchar int n\n")),
              HasSubstr("scalar"));
  EXPECT_THAT(message(header("binary_little_endian", "2", kXyz) + std::string(23, '\0')),
              HasSubstr("23"));
  EXPECT_THAT(message(header("ascii", "2", kXyz) + "1 2 3\n"), HasSubstr("truncated"));
  EXPECT_THAT(message(header("ascii", "1", kXyz) + "1 2\n"), HasSubstr("3 numbers"));
  EXPECT_THAT(message(header("ascii", "1", kXyz) + "1 2 3 4\n"), HasSubstr("3 numbers"));
  EXPECT_THAT(message(header("ascii", "1", kXyz) + "1 2 nan\n"),
              HasSubstr("no point with finite coordinates"));
  EXPECT_THAT(message(header("ascii", "1", kXyz) + "1 2e7 3\n"), HasSubstr("at most 1e7"));
  EXPECT_THAT(message("ply\nformat binary_big_endian 1.0\nelement face 1\n"
                      "property list uchar int n\nelement vertex 0\n" +
                      kXyz + "end_header\n\xff"),
              HasSubstr("ends before its vertices"));
  EXPECT_THAT(message("ply\nformat ascii 1.0\nelement face 1\nend_header\n"), HasSubstr("vertex"));
  EXPECT_THAT(message("ply\nelement vertex 0\n" + kXyz + "end_header\n"), HasSubstr("format"));
}

}  // namespace
}  // namespace redrive
