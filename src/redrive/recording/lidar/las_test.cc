// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/las.h"

#include <limits>
#include <random>

#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/lidar/las_testing.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;
using testing::las_file;
using testing::laz_file;
using testing::overwrite;

std::uint64_t time_bits(double time_ns) { return std::bit_cast<std::uint64_t>(time_ns); }

/// Points of consecutive packets.
std::vector<LasRecord> few_points(std::size_t count = 10) {
  std::vector<LasRecord> points;
  for (std::size_t i = 0; i < count; ++i) {
    const auto n = static_cast<std::int32_t>(i);
    points.push_back({.x = 1000 * n,
                      .y = -7 * n,
                      .z = n % 3,
                      .intensity = static_cast<std::uint16_t>(17 * i % 256),
                      .returns = 011,
                      .gps_time_bits = time_bits(4.8e12 + 167000.0 * static_cast<double>(i / 4))});
  }
  return points;
}

/// Points that use every branch of the compressor: steps from 0 to 32 bits, all return numbers,
/// interleaved times.
std::vector<LasRecord> wild_points(int count) {
  std::mt19937_64 random(7);
  const auto below = [&](std::uint64_t n) { return static_cast<int>(random() % n); };
  std::uint64_t times[6];
  for (std::uint64_t& time : times) time = random();
  std::int32_t steps[6] = {1000, -7, 0, 30000, 1 << 28, 3};
  std::vector<LasRecord> points;
  LasRecord point;
  int bits = 0, sequence = 0;
  for (int i = 0; i < count; ++i) {
    if (below(50) == 0) bits = below(33);
    for (std::int32_t* coordinate : {&point.x, &point.y, &point.z}) {
      const auto step = static_cast<std::uint32_t>(random() & ((std::uint64_t{1} << bits) - 1));
      *coordinate = static_cast<std::int32_t>(static_cast<std::uint32_t>(*coordinate) +
                                              (below(2) ? step : -step));
    }
    if (below(3) == 0) point.intensity = static_cast<std::uint16_t>(below(below(2) ? 65536 : 256));
    if (below(2) == 0) point.returns = static_cast<std::uint8_t>(below(2) ? below(256) : 011);
    if (below(5) == 0) point.classification = static_cast<std::uint8_t>(below(256));
    if (below(5) == 0) point.scan_angle = static_cast<std::uint8_t>(below(256));
    if (below(5) == 0) point.user_data = static_cast<std::uint8_t>(below(256));
    if (below(5) == 0) point.source_id = static_cast<std::uint16_t>(below(65536));
    if (below(10) == 0) sequence = below(6);
    if (below(100) == 0) steps[sequence] = static_cast<std::int32_t>(random() >> (32 + below(32)));
    const int multiples[] = {1, 1, 1, 0, below(12), below(520), -below(13), below(1200) - 600};
    const std::int64_t jitter = below(4) ? 0 : below(100) - 50;
    times[sequence] +=
        static_cast<std::uint64_t>(std::int64_t{multiples[below(8)]} * steps[sequence] + jitter);
    if (below(60) == 0) times[sequence] += random();
    point.gps_time_bits = times[sequence];
    points.push_back(point);
  }
  return points;
}

std::vector<LasRecord> decode(const std::string& file, std::uint32_t points,
                              std::uint32_t points_per_chunk) {
  return decode_laz(file, {little_endian<std::uint32_t>(file, 96), points, points_per_chunk},
                    "dir/points.laz");
}

TEST(Las, ReadsKnownValues) {
  std::string file = las_file(std::vector<LasRecord>{
      {.x = 1500, .y = -250, .z = 1, .intensity = 255, .gps_time_bits = time_bits(4833121676000)},
      {.x = INT16_MIN, .y = 0, .z = -3, .intensity = 65535, .gps_time_bits = time_bits(-0.6)}});
  const double scale_and_offset[] = {0.001, 0.01, 0.5, 10, -20, 0.25};
  for (std::size_t i = 0; i < 6; ++i) overwrite(&file, 131 + 8 * i, scale_and_offset[i]);
  const std::vector<LidarPoint> points = parse_las(file, "points.las");
  ASSERT_EQ(points.size(), 2u);
  EXPECT_EQ(points[0].in_body_m, Eigen::Vector3f(11.5, -22.5, 0.75));
  EXPECT_EQ(points[0].intensity, 255);
  EXPECT_EQ(points[0].t_ns, 4833121676000);
  EXPECT_EQ(points[1].in_body_m, Eigen::Vector3f(-22.768f, -20, -1.25));
  EXPECT_EQ(points[1].intensity, 65535);
  EXPECT_EQ(points[1].t_ns, -1);
  EXPECT_TRUE(parse_las(las_file({}), "points.las").empty());
}

/// A file of one point, 1 m ahead, of a version and point format, with four more bytes a record.
std::string las_of(int minor, int format, std::size_t least_bytes, std::size_t time_at) {
  std::string bytes = las_file({}), record(least_bytes + 4, '\0');
  const std::size_t header = minor == 4 ? 375 : minor == 3 ? 235 : 227;
  bytes.resize(header);
  bytes[25] = static_cast<char>(minor);
  bytes[104] = static_cast<char>(format);
  overwrite(&bytes, 94, static_cast<std::uint16_t>(header));
  overwrite(&bytes, 96, static_cast<std::uint32_t>(header));
  overwrite(&bytes, 105, static_cast<std::uint16_t>(record.size()));
  if (minor == 4)
    overwrite(&bytes, 247, std::uint64_t{1});
  else
    overwrite(&bytes, 107, std::uint32_t{1});
  overwrite(&record, 0, std::int32_t{1000});
  overwrite(&record, 12, std::uint16_t{77});
  if (time_at > 0) overwrite(&record, time_at, 5e9);
  return bytes + record + (minor >= 3 ? "waveforms" : "");
}

TEST(Las, ReadsVersionsAndPointFormats) {
  // Record lengths and offsets of gps_time, tables 7 to 17 of the specification of LAS 1.4.
  const std::size_t lengths[] = {20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67};
  for (int minor = 0; minor <= 4; ++minor)
    for (int format = 0; format <= 10; ++format) {
      const std::size_t time_at = format == 0 || format == 2 ? 0 : format < 6 ? 20 : 22;
      const auto points = parse_las(las_of(minor, format, lengths[format], time_at), "a.las", 42);
      ASSERT_EQ(points.size(), 1u) << minor << " " << format;
      EXPECT_EQ(points[0].in_body_m, Eigen::Vector3f(1, 0, 0));
      EXPECT_EQ(points[0].intensity, 77);
      EXPECT_EQ(points[0].t_ns, time_at > 0 ? 5'000'000'000 : 42) << format;
    }
}

TEST(Las, DetectsCompressionByTheHeader) {
  TemporaryFolder folder;
  const std::vector<LasRecord> points = few_points();
  folder.write("a.laz", las_file(points));
  folder.write("a.las", laz_file(points, 4));
  const auto plain = read_las(folder.path / "a.laz"), compressed = read_las(folder.path / "a.las");
  ASSERT_EQ(plain.size(), points.size());
  ASSERT_EQ(compressed.size(), points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d expected_m(1.0 * points[i].x, 1.0 * points[i].y, 1.0 * points[i].z);
    EXPECT_LT((plain[i].in_body_m.cast<double>() - 0.001 * expected_m).norm(), 1e-6);
    EXPECT_EQ(plain[i].t_ns, 4800000000000 + 167000 * static_cast<std::int64_t>(i / 4));
    EXPECT_EQ(plain[i].in_body_m, compressed[i].in_body_m);
    EXPECT_EQ(plain[i].t_ns, compressed[i].t_ns);
    EXPECT_EQ(plain[i].intensity, compressed[i].intensity);
  }
  EXPECT_THAT(input_error([&] { read_las(folder.path / "b.las"); }), HasSubstr("b.las"));
}

TEST(Laz, RoundTrip) {
  const std::vector<LasRecord> points = wild_points(20000);
  for (const std::uint32_t points_per_chunk : {50000u, 20000u, 19999u, 6000u}) {
    const std::string file = laz_file(points, points_per_chunk);
    EXPECT_EQ(decode(file, 20000, points_per_chunk), points) << points_per_chunk;
  }
  EXPECT_EQ(decode(laz_file(few_points(5), 1), 5, 1), few_points(5));
  EXPECT_TRUE(decode(laz_file({}, 4), 0, 4).empty());
}

// laz-perf 0.0.7 (npm), an independent implementation, decodes exactly this file. The checksum
// prevents decoder and encoder from changing together.
TEST(Laz, AgreesWithLazPerf) {
  std::uint64_t fnv1a = 0xcbf29ce484222325;
  for (const char c : laz_file(wild_points(20000), 6000))
    fnv1a = (fnv1a ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  EXPECT_EQ(fnv1a, 17864507545405170413u);
}

// Point formats 0 to 3, with bytes behind each of the last.
constexpr LazItems kItems[] = {{.gps_time = false},
                               {},
                               {.gps_time = false, .colours = true},
                               {.colours = true},
                               {.colours = true, .extra_bytes = 3}};

TEST(Laz, ReadsTheFormatsThatHaveNoTimeOrColours) {
  for (const LazItems& items : kItems) {
    std::vector<LasRecord> points = few_points(3000);
    const std::string file = laz_file(points, 700, items);
    std::vector<LasRecord> now =
        decode_laz(file, {little_endian<std::uint32_t>(file, 96), 3000, 700, items}, "a.laz");
    if (!items.gps_time)
      for (LasRecord& point : points) point.gps_time_bits = 0;
    EXPECT_EQ(now, points);
    const std::vector<LidarPoint> read = parse_las(file, "a.laz", 50'000'000'000);
    ASSERT_EQ(read.size(), 3000u);
    EXPECT_EQ(read[7].t_ns == 50'000'000'000, !items.gps_time);
    for (std::size_t size = 0; size < file.size(); size += 97)
      EXPECT_THROW(parse_las(std::string_view(file).substr(0, size), "a.laz"), InputError);
  }
}

// laz-perf 0.0.7 decodes these files to the points, colours and bytes that they were made of.
TEST(Laz, ColoursAndBytesAgreeWithLazPerf) {
  std::uint64_t fnv1a = 0xcbf29ce484222325;
  for (const LazItems& items : kItems)
    for (const char c : laz_file(wild_points(5000), 2000, items))
      fnv1a = (fnv1a ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  EXPECT_EQ(fnv1a, 59095340164810998u);
}

TEST(Laz, CompressedFormatsThatAreNotReadAreNamedWithAWayOut) {
  std::string file = laz_file(few_points(), 4);
  for (const int format : {4, 5, 6, 7, 8, 9, 10}) {
    file[104] = static_cast<char>(0x80 + format);
    EXPECT_THAT(input_error([&] { parse_las(file, "dir/points.laz"); }),
                AllOf(HasSubstr("dir/points.laz: point data format = "),
                      HasSubstr("is format " + std::to_string(format) + " compressed"),
                      HasSubstr("as .las")));
  }
}

TEST(Laz, RefusesMoreExtraBytesThanAnyoneWrites) {
  const std::string file = laz_file(few_points(), 4, {.extra_bytes = 65});
  EXPECT_THAT(input_error([&] { parse_las(file, "a.laz"); }),
              HasSubstr("point data record length = 93: at most 64"));
}

template <class T>
std::string las_message(std::string file, std::size_t offset, T value) {
  overwrite(&file, offset, value);
  const std::string message = input_error([&] { parse_las(file, "dir/points.las"); });
  EXPECT_THAT(message, HasSubstr("dir/points.las: "));
  return message;
}

TEST(Las, RejectsInvalidHeaders) {
  const std::string file = las_file(few_points());
  EXPECT_THAT(las_message(file, 3, 'X'), HasSubstr("signature"));
  EXPECT_THAT(input_error([&] { parse_las("", "dir/points.las"); }), HasSubstr("signature"));
  EXPECT_THAT(input_error([&] { parse_las(file.substr(0, 226), "dir/points.las"); }),
              AllOf(HasSubstr("226"), HasSubstr("227")));
  EXPECT_THAT(las_message(file, 24, '\2'), HasSubstr("version = 2.2"));
  EXPECT_THAT(las_message(file, 25, '\5'), HasSubstr("version = 1.5"));
  EXPECT_THAT(las_message(file, 25, '\4'), HasSubstr("header size = 227"));
  EXPECT_THAT(las_message(file, 94, std::uint16_t{226}), HasSubstr("header size = 226"));
  EXPECT_THAT(las_message(file, 94, std::uint16_t{60000}), HasSubstr("header size = 60000"));
  EXPECT_THAT(las_message(file, 96, std::uint32_t{226}), HasSubstr("offset to point data = 226"));
  EXPECT_THAT(las_message(file, 96, std::uint32_t{4000000000}),
              HasSubstr("offset to point data = 4000000000"));
  EXPECT_THAT(las_message(file, 104, '\x0b'), HasSubstr("point data format = 11"));
  EXPECT_THAT(las_message(file, 104, '\x83'), HasSubstr("must be at least 34, as in format 3"));
  EXPECT_THAT(las_message(file, 105, std::uint16_t{27}),
              HasSubstr("point data record length = 27"));
  EXPECT_THAT(las_message(file, 107, std::uint32_t{11}),
              AllOf(HasSubstr("number of points = 11"), HasSubstr("280 bytes")));
  EXPECT_THAT(las_message(file, 107, std::uint32_t{9}), HasSubstr("number of points = 9"));
  EXPECT_THAT(las_message(file, 107, UINT32_MAX), HasSubstr("number of points = 4294967295"));
  EXPECT_THAT(input_error([&] { parse_las(file.substr(0, file.size() - 1), "dir/points.las"); }),
              AllOf(HasSubstr("number of points = 10"), HasSubstr("279 bytes")));
}

TEST(Las, RejectsInvalidNumbers) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN(),
                   kInfinity = std::numeric_limits<double>::infinity();
  const std::string file = las_file(few_points());
  EXPECT_THAT(las_message(file, 131, 0.0), HasSubstr("x scale factor = 0"));
  EXPECT_THAT(las_message(file, 139, -0.001), HasSubstr("y scale factor = -0.001"));
  EXPECT_THAT(las_message(file, 147, kNan), HasSubstr("z scale factor = nan"));
  EXPECT_THAT(las_message(file, 147, kInfinity), HasSubstr("z scale factor = inf"));
  EXPECT_THAT(las_message(file, 155, kNan), HasSubstr("x offset = nan"));
  EXPECT_THAT(las_message(file, 171, kInfinity), HasSubstr("z offset = inf"));
  EXPECT_THAT(las_message(file, 163, 500000.0),
              AllOf(HasSubstr("point 0 y = 500000"), HasSubstr("1e4 m")));
  EXPECT_THAT(las_message(file, 131, 1e308), HasSubstr("point 1 x = inf"));
  for (const double time : {kNan, kInfinity, -1e19})
    EXPECT_THAT(las_message(file, 227 + 3 * 28 + 20, time),
                AllOf(HasSubstr("point 3 gps_time"), HasSubstr("nanoseconds")));
}

TEST(Las, PointsThatCannotBeAreLeftOutAndCounted) {
  std::string file = make_las(std::vector<LidarRecord>(40, {{9, 2, 1}, 50, 7}));
  for (const std::size_t point : {3, 8})
    overwrite(&file, 227 + point * 28 + 20, std::numeric_limits<double>::quiet_NaN());
  std::size_t left_out = 0;
  EXPECT_EQ(parse_las(file, "a.las", 0, &left_out).size(), 38u);
  EXPECT_EQ(left_out, 2u);
  overwrite(&file, 227 + 9 * 28 + 20, std::numeric_limits<double>::infinity());
  EXPECT_THAT(input_error([&] { parse_las(file, "a.las"); }), HasSubstr("point 3 gps_time"));
}

TEST(Las, ACutFileHasNoPointsToCount) {
  TemporaryFolder folder;
  for (const std::string& file : {las_file(few_points()), laz_file(few_points(), 4)}) {
    folder.write("a.las", file);
    EXPECT_EQ(las_point_count(folder.path / "a.las"), few_points().size());
    folder.write("a.las", file.substr(0, file.size() - 30));
    EXPECT_EQ(las_point_count(folder.path / "a.las"), 0u);
  }
}

TEST(Las, RejectsInvalidVariableLengthRecords) {
  const std::string content(40, 'x');
  const std::string file = testing::las_header(
      0, {testing::variable_record("a", 1, content), testing::variable_record("b", 2, content)});
  EXPECT_TRUE(parse_las(file, "points.las").empty());
  EXPECT_THAT(las_message(file, 100, std::uint32_t{3}), HasSubstr("variable length record 2"));
  EXPECT_THAT(las_message(file, 100, UINT32_MAX), HasSubstr("variable length record 2"));
  EXPECT_THAT(las_message(file, 227 + 20, std::uint16_t{65535}),
              HasSubstr("variable length record 0 length = 65535"));
  EXPECT_THAT(las_message(file, 227 + 94 + 20, std::uint16_t{41}),
              HasSubstr("variable length record 1 length = 41"));
}

TEST(Laz, RejectsUnsupportedLaszipRecords) {
  const std::string file = laz_file(few_points(), 4);
  const std::size_t record = 227 + 54 + 4 + 54;
  EXPECT_THAT(las_message(las_file(few_points()), 104, '\x81'), HasSubstr("none is LASzip's"));
  EXPECT_THAT(las_message(file, record - 54 + 2, 'L'), HasSubstr("none is LASzip's"));
  EXPECT_THAT(las_message(file, 104, '\1'),
              AllOf(HasSubstr("point data format = 1"), HasSubstr("128 added")));
  EXPECT_THAT(las_message(file, record - 54 + 20, std::uint16_t{40}),
              HasSubstr("LASzip record length = 40"));
  EXPECT_THAT(las_message(file, record, std::uint16_t{3}), HasSubstr("LASzip compressor = 3"));
  EXPECT_THAT(las_message(file, record + 2, std::uint16_t{1}), HasSubstr("LASzip coder = 1"));
  EXPECT_THAT(las_message(file, record + 12, std::uint32_t{0}), HasSubstr("LASzip chunk size = 0"));
  EXPECT_THAT(las_message(file, record + 12, UINT32_MAX),
              HasSubstr("LASzip chunk size = 4294967295"));
  EXPECT_THAT(las_message(file, record + 32, std::uint16_t{3}),
              HasSubstr("LASzip number of items = 3"));
  EXPECT_THAT(las_message(file, record + 34, std::uint16_t{10}),
              HasSubstr("LASzip item 0 type = 10"));
  EXPECT_THAT(las_message(file, record + 36, std::uint16_t{30}),
              HasSubstr("LASzip item 0 size = 30"));
  EXPECT_THAT(las_message(file, record + 38, std::uint16_t{1}),
              HasSubstr("LASzip item 0 version = 1"));
  EXPECT_THAT(las_message(file, record + 40, std::uint16_t{8}),
              HasSubstr("LASzip item 1 type = 8"));
  EXPECT_THAT(las_message(file, record + 42, std::uint16_t{6}),
              HasSubstr("LASzip item 1 size = 6"));
  EXPECT_THAT(las_message(file, record + 44, std::uint16_t{1}),
              HasSubstr("LASzip item 1 version = 1"));
}

TEST(Laz, RejectsInvalidChunkTables) {
  const std::string file = laz_file(few_points(), 4);
  const std::size_t begin = little_endian<std::uint32_t>(file, 96), record = begin - 46;
  const auto table = static_cast<std::size_t>(little_endian<std::int64_t>(file, begin));
  for (const std::int64_t position :
       {std::int64_t{-1}, std::int64_t{0}, static_cast<std::int64_t>(begin + 7),
        static_cast<std::int64_t>(file.size() - 7), INT64_MAX, INT64_MIN})
    EXPECT_THAT(las_message(file, begin, position),
                HasSubstr("chunk table position = " + std::to_string(position)));
  EXPECT_THAT(las_message(file, table, std::uint32_t{1}), HasSubstr("chunk table version = 1"));
  EXPECT_THAT(las_message(file, table + 4, std::uint32_t{2}),
              AllOf(HasSubstr("number of chunks = 2"), HasSubstr("must be 3")));
  EXPECT_THAT(las_message(file, 107, std::uint32_t{13}),
              AllOf(HasSubstr("number of chunks = 3"), HasSubstr("must be 4")));
  EXPECT_THAT(las_message(file, table + 9, '\x7f'), HasSubstr("chunk"));
  // The last chunk holds two points; the header claims three, or one.
  EXPECT_THAT(las_message(file, 107, std::uint32_t{11}), HasSubstr("chunk 2 = point 10"));
  EXPECT_THAT(las_message(file, 107, std::uint32_t{9}),
              AllOf(HasSubstr("chunk 2"), HasSubstr("are left")));
  std::string many = laz_file(few_points(), 4);
  overwrite(&many, 107, std::uint32_t{4'000'000});
  overwrite(&many, record + 12, std::uint32_t{1});
  EXPECT_THAT(las_message(many, table + 4, std::uint32_t{4'000'000}),
              AllOf(HasSubstr("number of chunks = 4000000"), HasSubstr("do not fit")));
  std::string gap = file;  // a byte between the last chunk and the table
  gap.insert(table, 1, '\0');
  EXPECT_THAT(las_message(gap, begin, static_cast<std::int64_t>(table + 1)),
              AllOf(HasSubstr("chunk table = 1"), HasSubstr("between")));
}

TEST(Laz, RejectsTruncatedFiles) {
  const std::string file = laz_file(few_points(), 4);
  for (std::size_t size = 0; size < file.size(); ++size)
    EXPECT_THAT(
        input_error([&] { parse_las(std::string_view(file).substr(0, size), "dir/points.laz"); }),
        HasSubstr("dir/points.laz"))
        << size;
}

TEST(Laz, RejectsDamagedChunks) {
  // LAZ has no checksum, but a flipped bit almost always changes the length of the code.
  const std::string file = laz_file(few_points(200), 100);
  const std::size_t begin = little_endian<std::uint32_t>(file, 96);
  const auto table = static_cast<std::size_t>(little_endian<std::int64_t>(file, begin));
  int damaged = 0, noticed = 0;
  for (std::size_t i = begin + 8 + 28; i < table; ++i) {
    std::string copy = file;
    copy[i] = static_cast<char>(copy[i] ^ 0x10);
    ++damaged;
    try {
      std::size_t left_out = 0;
      const std::size_t left = parse_las(copy, "points.laz", 0, &left_out).size();
      EXPECT_EQ(left + left_out, 200u);
    } catch (const InputError&) {
      ++noticed;
    }
  }
  EXPECT_GT(noticed, damaged / 2);
}

TEST(MakeLas, ComesBack) {
  std::vector<LidarRecord> points;
  for (int i = 0; i < 50; ++i)
    points.push_back({Eigen::Vector3f(0.1f * i, -7.3f * i, 1.0f / 3.0f).cast<double>(),
                      4'833'238'566'001 + i, static_cast<float>(1000 * i) / 65535});
  const auto same = [&](double step_m, double tolerance_m) {
    const std::vector<LidarPoint> now = parse_las(make_las(points, step_m), "a.las");
    ASSERT_EQ(now.size(), points.size());
    for (std::size_t i = 0; i < now.size(); ++i) {
      EXPECT_LT((now[i].in_body_m.cast<double>() - points[i].position_m).cwiseAbs().maxCoeff(),
                tolerance_m);
      EXPECT_EQ(now[i].intensity, 1000 * i);
      EXPECT_EQ(now[i].t_ns, points[i].t_ns);
    }
  };
  same(1e-6, 1e-6);
  points[3].position_m.x() = 9000;
  same(1e-5, 1e-3);  // floats of 9000 m
  points.clear();
  same(1e-6, 1e-6);
}

}  // namespace
}  // namespace redrive
