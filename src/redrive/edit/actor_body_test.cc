// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/actor_body.h"

#include <chrono>
#include <cmath>
#include <filesystem>
#include <limits>

#include "redrive/base/files/gzip.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/field/gaussian.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/lidar/las_testing.h"

namespace redrive {
namespace {

using testing::append;
using ::testing::HasSubstr;
using testing::input_error;

constexpr double kC0 = 0.28209479177387814, kC1 = 0.48860251190291987;

/// Numbers of a Gaussian in the order of the file.
using Row = std::vector<float>;

std::vector<std::string> names(int rest) {
  std::vector<std::string> out = {"x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"};
  for (int i = 0; i < rest; ++i) out.push_back("f_rest_" + std::to_string(i));
  for (const char* name :
       {"opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"})
    out.emplace_back(name);
  return out;
}

Row gaussian(int rest, float x) {
  Row row = {x, 0.5f, -0.25f, 0, 0, 0, 1, 2, -1};
  for (int i = 0; i < rest; ++i) row.push_back(0.1f * float(i));
  for (const float number : {0.75f, -3.0f, -4.0f, -5.0f, 1.0f, 0.0f, 0.0f, 2.0f})
    row.push_back(number);
  return row;
}

std::string header(const std::string& n, int rest, const std::string& comments = "") {
  std::string text =
      "ply\nformat binary_little_endian 1.0\n" + comments + "element vertex " + n + "\n";
  for (const std::string& name : names(rest)) text += "property float " + name + "\n";
  return text + "end_header\n";
}

std::string file_of(const std::vector<Row>& rows, int rest, const std::string& comments = "") {
  std::string bytes = header(std::to_string(rows.size()), rest, comments);
  for (const Row& row : rows)
    for (const float number : row) append(&bytes, number);
  return bytes;
}

std::string message(const std::string& bytes) {
  const std::string text = input_error([&] { parse_actor_body(bytes, "dir/van.ply"); });
  EXPECT_THAT(text, HasSubstr("dir/van.ply"));
  return text;
}

TEST(ActorBody, HasTheNumbersOfTheFileUpToDegreeOne) {
  for (const int rest : {0, 9, 24, 45}) {
    std::vector<Row> rows;
    for (int i = 0; i < 17; ++i) rows.push_back(gaussian(rest, 0.1f * float(i)));
    const ActorBody body = parse_actor_body(file_of(rows, rest), "van.ply");
    ASSERT_EQ(body.n, 17u);
    ASSERT_EQ(body.numbers.size(), 2 * kBlockSize);
    const auto at = [&](std::size_t i, int row) { return body.numbers[gaussian_slot(i, row)]; };
    for (const std::size_t i : {0u, 16u}) {
      EXPECT_EQ(at(i, kPositionRow), rows[i][0]);
      EXPECT_EQ(at(i, kPositionRow + 2), -0.25f);
      EXPECT_EQ(at(i, kLogScaleRow + 1), -4);
      EXPECT_EQ(at(i, kQuaternionRow + 3), 2);
      EXPECT_EQ(at(i, kOpacityRow), 0.75f);
      EXPECT_NEAR(at(i, kColourRow + 1), 0.5 + 2 * kC0, 1e-6);
      // Green's coefficients of degree 1 follow y, z, x, with the signs of the basis.
      const double first = 0.1 * (rest / 3);
      const double expected[3] = {-kC1 * (first + 0.2), -kC1 * first, kC1 * (first + 0.1)};
      for (int axis = 0; axis < 3; ++axis)
        EXPECT_NEAR(at(i, kHarmonicsRow + 3 * axis + 1), rest > 0 ? expected[axis] : 0, 1e-5)
            << rest;
    }
    for (std::size_t i = 17; i < 32; ++i) EXPECT_LT(at(i, kOpacityRow), -10) << "unused";
  }
}

TEST(ActorBody, HasTypeAndSizeOfItsComments) {
  std::string comments;
  for (const std::string& comment : body_comments("CAR\nTRUCK", {4.5, 1.875, 1.5}))
    comments += "comment " + comment + "\n";
  const ActorBody body =
      parse_actor_body(file_of({gaussian(0, 1)}, 0, "comment by hand\n" + comments), "van.ply");
  EXPECT_EQ(body.type, "CAR_TRUCK");
  EXPECT_EQ(body.size_m, Eigen::Vector3d(4.5, 1.875, 1.5));
}

TEST(ActorBody, IsMeasuredWithoutAComment) {
  std::vector<Row> rows;
  for (int i = 0; i <= 100; ++i) rows.push_back(gaussian(0, 0.02f * float(i)));
  rows.back()[0] = 50;
  const ActorBody body = parse_actor_body(file_of(rows, 0), "van.ply");
  EXPECT_NEAR(body.size_m.x(), 2 * 0.02 * 98, 1e-5) << "without the one that strays";
  EXPECT_NEAR(body.size_m.y(), 1, 1e-6);
  EXPECT_EQ(body.type, "");
}

TEST(ActorBody, RefusesEveryCutFile) {
  const std::string bytes = file_of({gaussian(9, 0), gaussian(9, 1)}, 9);
  for (std::size_t size = 0; size < bytes.size(); ++size) message(bytes.substr(0, size));
}

TEST(ActorBody, RefusesOtherCountsAndNumbers) {
  EXPECT_THAT(message(header("1000000000", 0)), HasSubstr("up to 1000000"));
  EXPECT_THAT(message(header("0", 0)), HasSubstr("1 at least"));
  EXPECT_THAT(message(header("-1", 0)), HasSubstr("element vertex -1"));
  EXPECT_THAT(message(header("3", 0)), HasSubstr("do not fit"));
  EXPECT_THAT(message(file_of({gaussian(3, 0)}, 3)), HasSubstr("0, 9, 24 or 45"));
  EXPECT_THAT(message(file_of({gaussian(0, 0)}, 0, "comment redrive size_m 4 2\n")),
              HasSubstr("three metres"));
  EXPECT_THAT(message(file_of({gaussian(0, 0)}, 0, "comment redrive size_m 4 2 -1\n")),
              HasSubstr("three metres"));
  for (const float wrong :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 1e9f})
    for (std::size_t k = 0; k < names(9).size(); ++k) {
      if (k >= 3 && k < 6) continue;  // normals are not read
      std::vector<Row> rows = {gaussian(9, 0), gaussian(9, 1)};
      rows[1][k] = wrong;
      EXPECT_THAT(message(file_of(rows, 9)), HasSubstr("vertex 1 " + names(9)[k]));
    }
  std::vector<Row> rows = {gaussian(0, 0)};
  rows[0][13] = rows[0][16] = 0;
  EXPECT_THAT(message(file_of(rows, 0)), HasSubstr("quaternion"));
  std::string lacking = file_of({gaussian(0, 0)}, 0);
  lacking.replace(lacking.find("rot_3"), 5, "rot_4");
  EXPECT_THAT(message(lacking), HasSubstr("rot_3"));
}

/// An SPZ before it is compressed, of Gaussians that are all alike: at (1, 0.5, -0.25), red at
/// most, with 12 fractional bits.
std::string spz(std::uint32_t version, unsigned char degree, std::uint32_t n) {
  std::string bytes = "NGSP";
  append(&bytes, version);
  append(&bytes, n);
  for (const unsigned char byte : {degree, static_cast<unsigned char>(12)}) append(&bytes, byte);
  bytes += std::string("\1\0", 2);
  const auto repeat = [&](const std::string& of_one) {
    for (std::uint32_t i = 0; i < n; ++i) bytes += of_one;
  };
  repeat(std::string("\x00\x10\x00\x00\x08\x00\x00\xfc\xff", 9));
  repeat("\x99");  // opacity 0.6
  repeat(std::string("\xff\x00\x80", 3));
  repeat("\x60\x68\x70");  // exp(-4), exp(-3.5), exp(-3)
  // Half a turn about z; of version 3 the largest is z, and x, y, w are 0, 0 and -511 / 511 /
  // sqrt2.
  repeat(version == 2 ? std::string("\x80\x80\xff", 3) : std::string("\xff\x03\x00\x80", 4));
  for (std::uint32_t i = 0; i < n; ++i)
    for (int j = 0; j < degree * (degree + 2); ++j)
      for (int c = 0; c < 3; ++c) bytes += static_cast<char>(128 + 4 * j + c);
  return bytes;
}

TEST(ActorBody, HasTheNumbersOfAnSpz) {
  for (const std::uint32_t version : {2u, 3u})
    for (const unsigned char degree : {0, 1, 2, 3}) {
      const ActorBody body = parse_actor_body(gzip(spz(version, degree, 17)), "van.spz");
      ASSERT_EQ(body.n, 17u);
      for (const std::size_t i : {0u, 16u}) {
        const auto at = [&](int row) { return body.numbers[gaussian_slot(i, row)]; };
        EXPECT_EQ(at(kPositionRow), 1);
        EXPECT_EQ(at(kPositionRow + 1), 0.5f);
        EXPECT_EQ(at(kPositionRow + 2), -0.25f);
        EXPECT_NEAR(at(kOpacityRow), std::log(0.6 / 0.4), 1e-6);
        EXPECT_NEAR(at(kColourRow), 0.5 + kC0 * 0.5 / 0.15, 1e-6);
        EXPECT_NEAR(at(kColourRow + 1), 0.5 - kC0 * 0.5 / 0.15, 1e-6);
        EXPECT_EQ(at(kLogScaleRow), -4);
        EXPECT_EQ(at(kLogScaleRow + 2), -3);
        const double w = at(kQuaternionRow), z = at(kQuaternionRow + 3);
        EXPECT_NEAR(w * w + z * z, 1, 1e-4) << version;
        EXPECT_NEAR(w, version == 2 ? 0 : -std::sqrt(0.5), 1e-2);
        // Blue's coefficients of degree 1, of y, z and x.
        const double rest[3] = {2 / 128.0, 6 / 128.0, 10 / 128.0};
        const double expected[3] = {-kC1 * rest[2], -kC1 * rest[0], kC1 * rest[1]};
        for (int axis = 0; axis < 3; ++axis)
          EXPECT_NEAR(at(kHarmonicsRow + 3 * axis + 2), degree > 0 ? expected[axis] : 0, 1e-6);
      }
      EXPECT_EQ(body.size_m, Eigen::Vector3d(2, 1, 0.5));
    }
}

TEST(ActorBody, RefusesEveryCutSpzAndOtherHeaders) {
  const std::string bytes = spz(3, 1, 2);
  for (std::size_t size = 0; size < bytes.size(); ++size) message(gzip(bytes.substr(0, size)));
  message(gzip(bytes + "x"));
  const std::string file = gzip(bytes);
  EXPECT_THAT(message(file.substr(0, file.size() / 2)), HasSubstr("gzip"));
  const auto with = [&](std::size_t offset, char byte) {
    std::string changed = bytes;
    changed[offset] = byte;
    return message(gzip(changed));
  };
  EXPECT_THAT(with(0, 'X'), HasSubstr("header"));
  EXPECT_THAT(with(4, 1), HasSubstr("2 or 3"));
  EXPECT_THAT(with(11, 1), HasSubstr("1 to 1000000"));
  EXPECT_THAT(with(12, 4), HasSubstr("degree"));
  EXPECT_THAT(with(13, 24), HasSubstr("fractional bits"));
  EXPECT_THAT(with(18, 0x7f), HasSubstr("Gaussian 0 position"));
  EXPECT_THAT(with(16 + 2 * (9 + 1 + 3), static_cast<char>(255)), HasSubstr("Gaussian 0 scale"));
}

TEST(ActorBodies, AreReadOnceUnlessTheFileChanges) {
  const TemporaryFolder folder;
  folder.write("van.spz", gzip(spz(3, 0, 1)));
  ActorBodies bodies;
  const auto first = bodies.read(folder.path / "van.spz");
  EXPECT_EQ(bodies.read(folder.path / "van.spz"), first);
  folder.write("van.spz", gzip(spz(3, 0, 2)));
  std::filesystem::last_write_time(
      folder.path / "van.spz",
      std::filesystem::file_time_type::clock::now() + std::chrono::hours(1));
  EXPECT_EQ(bodies.read(folder.path / "van.spz")->n, 2u);
  std::filesystem::remove(folder.path / "van.spz");
  EXPECT_THROW(bodies.read(folder.path / "van.spz"), std::runtime_error);
}

}  // namespace
}  // namespace redrive
