// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/las.h"

#include <bit>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <string>

#include <Eigen/Geometry>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/lidar/laz_decoder.h"
#include "redrive/recording/lidar/unusable_returns.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

/// A point data format: the least bytes of a record, and the offset of its gps_time, 0: it has
/// none.
struct PointFormat {
  std::uint16_t bytes, gps_time;
};
constexpr PointFormat kPointFormats[] = {{20, 0},  {28, 20}, {26, 0},  {34, 20}, {57, 20}, {63, 20},
                                         {30, 22}, {36, 22}, {38, 22}, {59, 22}, {67, 22}};
constexpr int kMostCompressed = 3;           // the last point format that is read where compressed
constexpr int kMostExtraBytes = 64;          // each takes 3 kB of models
constexpr std::size_t kCountOffset14 = 247;  // offset of the 64-bit number of points in LAS 1.4
constexpr std::size_t kHeaderBytes14 = 375;
constexpr std::size_t kHeaderBytes = 227, kVariableHeaderBytes = 54, kPointCountOffset = 107;
constexpr std::uint32_t kMaxLasPoints =
    4'000'000;  // a revolution of 128 channels at 0.1 degrees has 0.46 million
constexpr double kMaxLasCoordinate_m = 1e4;
constexpr double kMaxTime_ns = 9e18;  // int64 ends at 9.22e18

std::string text(double value) {
  char buffer[32];
  std::snprintf(buffer, sizeof buffer, "%.17g", value);
  return buffer;
}

/// Parses a LAS file; checks its header against its size.
class LasFile {
 public:
  LasFile(std::string_view bytes, const std::filesystem::path& file) : bytes_(bytes), file_(file) {
    if (!bytes.starts_with("LASF")) refuse("signature", "", "is not LASF: no LAS or LAZ file");
    if (bytes.size() < kHeaderBytes)
      refuse("", std::to_string(bytes.size()) + " bytes", "truncated: a LAS header has 227");
    const int major = at<std::uint8_t>(24), minor = at<std::uint8_t>(25);
    if (major != 1 || minor > 4)
      refuse("version", std::to_string(major) + "." + std::to_string(minor), "must be 1.0 to 1.4");
    const auto header_bytes = at<std::uint16_t>(94);
    const std::size_t least_header = minor == 4 ? kHeaderBytes14 : kHeaderBytes;
    if (header_bytes < least_header || header_bytes > bytes.size())
      refuse("header size", header_bytes,
             "must be at least " + std::to_string(least_header) + " and fit in the file's " +
                 size() + " bytes");
    points_begin_ = at<std::uint32_t>(96);
    if (points_begin_ < header_bytes || points_begin_ > bytes.size())
      refuse("offset to point data", points_begin_,
             "must lie behind the header and in the file's " + size() + " bytes");
    const auto format = at<std::uint8_t>(104);
    compressed_ = format & 0x80;
    const int kind = format & 0x7f;
    if (kind >= static_cast<int>(std::size(kPointFormats)))
      refuse("point data format", format, "must be 0 to 10, with 128 added where compressed");
    if (compressed_ && kind > kMostCompressed)
      refuse("point data format", format,
             "is format " + std::to_string(kind) +
                 " compressed, and only 0 to 3 are read compressed; laszip, las2las or "
                 "pdal translate write the file as .las, which is read");
    format_ = kPointFormats[kind];
    record_bytes_ = at<std::uint16_t>(105);
    if (record_bytes_ < format_.bytes)
      refuse("point data record length", record_bytes_,
             "must be at least " + std::to_string(format_.bytes) + ", as in format " +
                 std::to_string(kind));
    if (compressed_ && record_bytes_ > format_.bytes + kMostExtraBytes)
      refuse("point data record length", record_bytes_,
             "at most " + std::to_string(kMostExtraBytes) +
                 " bytes beside the fields of the format are read where compressed");
    items_.gps_time = format_.gps_time > 0;
    items_.colours = kind == 2 || kind == 3;
    items_.extra_bytes = record_bytes_ - format_.bytes;
    std::uint64_t points = at<std::uint32_t>(kPointCountOffset);
    if (points == 0 && minor == 4) points = at<std::uint64_t>(kCountOffset14);
    points_ = static_cast<std::uint32_t>(points);
    more_may_follow_ = minor >= 3;
    if (points > kMaxLasPoints)
      refuse("number of points", std::to_string(points),
             "at most 4 million are accepted: a revolution has fewer");
    for (int axis = 0; axis < 3; ++axis) {
      const std::string name(1, "xyz"[axis]);
      scale_[axis] = at<double>(131 + 8 * static_cast<std::size_t>(axis));
      offset_[axis] = at<double>(155 + 8 * static_cast<std::size_t>(axis));
      if (!(scale_[axis] > 0 && std::isfinite(scale_[axis])))
        refuse(name + " scale factor", text(scale_[axis]), "must be > 0 and finite");
      if (!std::isfinite(offset_[axis]))
        refuse(name + " offset", text(offset_[axis]), "must be finite");
    }
    read_variable_records(header_bytes);
  }

  std::vector<LasRecord> records() const {
    if (compressed_)
      return decode_laz(bytes_,
                        {.begin = points_begin_,
                         .points = points_,
                         .points_per_chunk = points_per_chunk_,
                         .items = items_},
                        file_);
    const std::size_t stored = bytes_.size() - points_begin_;
    const std::size_t needed = std::size_t{points_} * record_bytes_;
    if (more_may_follow_ ? stored < needed : stored != needed)
      refuse("number of points", points_,
             "of " + std::to_string(record_bytes_) + " bytes each do not make up the " +
                 std::to_string(stored) + " bytes that follow (truncated?)");
    std::vector<LasRecord> records(points_);
    for (std::size_t i = 0; i < records.size(); ++i) {
      const std::size_t begin = points_begin_ + i * record_bytes_;
      records[i] = {.x = at<std::int32_t>(begin),
                    .y = at<std::int32_t>(begin + 4),
                    .z = at<std::int32_t>(begin + 8),
                    .intensity = at<std::uint16_t>(begin + 12)};
      if (format_.gps_time > 0)
        records[i].gps_time_bits = at<std::uint64_t>(begin + format_.gps_time);
    }
    return records;
  }

  LidarPoint point(const LasRecord& record, std::size_t index, std::int64_t frame_time_ns) const {
    const Eigen::Vector3d in_body_m =
        Eigen::Vector3d(record.x, record.y, record.z).cwiseProduct(scale_) + offset_;
    for (int axis = 0; axis < 3; ++axis) {
      if (!(std::abs(in_body_m[axis]) <= kMaxLasCoordinate_m))
        refuse("point " + std::to_string(index) + " " + "xyz"[axis], text(in_body_m[axis]),
               "no LiDAR sees further than 1e4 m; metres from the body's origin are expected");
    }
    const double time_ns = std::bit_cast<double>(record.gps_time_bits);
    if (!(std::abs(time_ns) <= kMaxTime_ns))
      refuse("point " + std::to_string(index) + " gps_time", text(time_ns),
             "must be nanoseconds between -9e18 and 9e18");
    return {.in_body_m = in_body_m.cast<float>(),
            .intensity = record.intensity,
            .t_ns = format_.gps_time > 0 ? std::llround(time_ns) : frame_time_ns};
  }

 private:
  template <class T>
  T at(std::size_t offset) const {
    return little_endian<T>(bytes_, offset);
  }
  std::string size() const { return std::to_string(bytes_.size()); }
  [[noreturn]] void refuse(const std::string& field, const std::string& value,
                           const std::string& rule) const {
    throw InputError(file_, field, value, rule);
  }
  [[noreturn]] void refuse(const std::string& field, std::uint32_t value,
                           const std::string& rule) const {
    refuse(field, std::to_string(value), rule);
  }

  // Only LASzip's record is needed: it describes the compression.
  void read_variable_records(std::size_t begin) {
    const auto count = at<std::uint32_t>(100);
    for (std::uint32_t i = 0; i < count; ++i) {
      const std::string name = "variable length record " + std::to_string(i);
      if (points_begin_ - begin < kVariableHeaderBytes)
        refuse(name, "",
               "must lie before the points, but only " + std::to_string(points_begin_ - begin) +
                   " bytes are left");
      const std::string_view user = bytes_.substr(begin + 2, 16);
      const auto id = at<std::uint16_t>(begin + 18);
      const std::size_t size = at<std::uint16_t>(begin + 20);
      begin += kVariableHeaderBytes;
      if (points_begin_ - begin < size)
        refuse(
            name + " length", static_cast<std::uint32_t>(size),
            "must end before the points, " + std::to_string(points_begin_ - begin) + " bytes on");
      if (user.starts_with("laszip encoded") && id == 22204)
        read_laszip_record(bytes_.substr(begin, size));
      begin += size;
    }
    if (compressed_ && points_per_chunk_ == 0)
      refuse("variable length records", count,
             "of which none is LASzip's, though the points are compressed");
  }

  void read_laszip_record(std::string_view record) {
    if (!compressed_)
      refuse("point data format", at<std::uint8_t>(104),
             "must have 128 added: there is a LASzip record");
    struct Item {
      const char* name;
      int type;
      std::size_t size;
    };
    std::vector<Item> items{{"POINT10", 6, 20}};
    if (items_.gps_time) items.push_back({"GPSTIME11", 7, 8});
    if (items_.colours) items.push_back({"RGB12", 8, 6});
    if (items_.extra_bytes > 0) items.push_back({"BYTE", 0, items_.extra_bytes});
    constexpr std::size_t kFixedBytes = 34, kItemBytes = 6;
    const std::size_t length = kFixedBytes + items.size() * kItemBytes;
    if (record.size() != length)
      refuse("LASzip record length", static_cast<std::uint32_t>(record.size()),
             "must be " + std::to_string(length) + ", with " + std::to_string(items.size()) +
                 " items as the point format has them");
    const auto expect = [&](const std::string& field, std::size_t offset, std::size_t expected,
                            const std::string& meaning) {
      const auto value = little_endian<std::uint16_t>(record, offset);
      if (value != expected)
        refuse("LASzip " + field, value, "must be " + std::to_string(expected) + ": " + meaning);
    };
    expect("compressor", 0, 2, "pointwise, in chunks");
    expect("coder", 2, 0, "arithmetic");
    points_per_chunk_ = little_endian<std::uint32_t>(record, 12);
    if (points_per_chunk_ == 0 || points_per_chunk_ == UINT32_MAX)
      refuse("LASzip chunk size", points_per_chunk_, "must be a fixed number of points");
    expect("number of items", 32, items.size(), "the items of the point format");
    for (std::size_t i = 0; i < items.size(); ++i) {
      const std::string item = "item " + std::to_string(i);
      const std::size_t begin = kFixedBytes + i * kItemBytes;
      expect(item + " type", begin, static_cast<std::size_t>(items[i].type), items[i].name);
      expect(item + " size", begin + 2, items[i].size, "bytes");
      expect(item + " version", begin + 4, 2, "no other is known here");
    }
  }

  std::string_view bytes_;
  std::filesystem::path file_;
  bool compressed_ = false;
  bool more_may_follow_ = false;  ///< behind the points: waveforms, extended records
  PointFormat format_{};
  LazItems items_;  ///< where compressed
  std::uint16_t record_bytes_ = 0;
  std::size_t points_begin_ = 0;
  std::uint32_t points_ = 0, points_per_chunk_ = 0;
  Eigen::Vector3d scale_, offset_;
};

}  // namespace

std::vector<LidarPoint> parse_las(std::string_view bytes, const std::filesystem::path& file,
                                  std::int64_t frame_time_ns, std::size_t* left_out) {
  const LasFile las(bytes, file);
  const std::vector<LasRecord> records = las.records();
  std::vector<LidarPoint> points;
  points.reserve(records.size());
  UnusableReturns unusable(records.size());
  for (std::size_t i = 0; i < records.size(); ++i) {
    try {
      points.push_back(las.point(records[i], i, frame_time_ns));
    } catch (const InputError& error) {
      unusable.add_impossible(error);
    }
  }
  if (left_out) *left_out += unusable.count();
  return points;
}

std::vector<LidarPoint> read_las(const std::filesystem::path& file, std::int64_t frame_time_ns,
                                 std::size_t* left_out) {
  return parse_las(read_file(file, kMaxDataBytes), file, frame_time_ns, left_out);
}

namespace {

/// An extra value of each point: LAS 1.4, table 24.
struct ExtraBytes {
  const char *name, *description;
  std::uint8_t type;
  std::uint16_t bytes;
};
constexpr std::uint8_t kUint8 = 1, kInt32 = 6, kFloat32 = 9;
constexpr ExtraBytes kExtraBytes[] = {{"ring", "number of its beam", kUint8, 1},
                                      {"azimuth", "radians, to the left", kFloat32, 4},
                                      {"range", "metres from the sensor", kFloat32, 4},
                                      {"actor", "id of a moving object", kInt32, 4},
                                      {"loss", "probability of no return", kFloat32, 4}};

void add_extra_bytes(const LidarRecord& point, std::string* bytes) {
  add_bytes(point.ring, bytes);
  add_bytes(point.azimuth_rad, bytes);
  add_bytes(point.range_m, bytes);
  add_bytes(point.actor, bytes);
  add_bytes(point.loss, bytes);
}

/// Returns the variable length record that describes the extra bytes.
std::string extra_bytes_record() {
  constexpr std::uint16_t kDescriptorBytes = 192, kRecordId = 4;
  const auto text = [](const char* words, std::size_t size) {
    std::string field = words;
    field.resize(size);
    return field;
  };
  std::string bytes(2, '\0');  // reserved
  bytes += text("LASF_Spec", 16);
  add_bytes(kRecordId, &bytes);
  add_bytes(static_cast<std::uint16_t>(kDescriptorBytes * std::size(kExtraBytes)), &bytes);
  bytes += text("extra bytes", 32);
  for (const ExtraBytes& extra : kExtraBytes) {
    const bool has_no_data = extra.type == kInt32;
    bytes += std::string(2, '\0');
    add_bytes(extra.type, &bytes);
    add_bytes(std::uint8_t{has_no_data}, &bytes);
    bytes += text(extra.name, 32) + text("", 4);
    add_bytes(std::int64_t{has_no_data ? kNoActor : 0}, &bytes);
    bytes += text("", 16 + 4 * 24);  // the rest of no data; least, most, scale and offset
    bytes += text(extra.description, 32);
  }
  return bytes;
}

}  // namespace

std::string make_las(std::span<const LidarRecord> points, double step_m, LasFields fields) {
  constexpr double kNone = std::numeric_limits<double>::infinity();
  Eigen::Vector3d least = Eigen::Vector3d::Constant(kNone), most = -least;
  for (const LidarRecord& point : points) {
    least = least.cwiseMin(point.position_m);
    most = most.cwiseMax(point.position_m);
  }
  if (points.empty()) least = most = Eigen::Vector3d::Zero();
  const double farthest_m = max_las_position_m(step_m);
  REDRIVE_CHECK(least.minCoeff() >= -farthest_m && most.maxCoeff() <= farthest_m);
  REDRIVE_CHECK_OP(points.size(), <=, std::numeric_limits<std::uint32_t>::max());
  const std::string extra = fields == LasFields::kAll ? extra_bytes_record() : "";
  std::uint16_t record_bytes = kPointFormats[1].bytes;
  if (fields == LasFields::kAll)
    for (const ExtraBytes& one : kExtraBytes) record_bytes += one.bytes;
  std::string bytes(kHeaderBytes, '\0');
  const auto put = [&](std::size_t offset, auto value) {
    std::memcpy(bytes.data() + offset, &value, sizeof value);
  };
  const auto n = static_cast<std::uint32_t>(points.size());
  bytes.replace(0, 4, "LASF");
  bytes[24] = 1, bytes[25] = 2;  // version 1.2
  bytes.replace(26, 7, "redrive");
  bytes.replace(58, 7, "redrive");
  put(94, static_cast<std::uint16_t>(kHeaderBytes));
  put(96, static_cast<std::uint32_t>(kHeaderBytes + extra.size()));  // offset of the points
  put(100, static_cast<std::uint32_t>(!extra.empty()));              // variable length records
  bytes[104] = 1;                                                    // point format
  put(105, record_bytes);
  put(kPointCountOffset, n);
  put(111, n);  // first returns
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto k = static_cast<Eigen::Index>(axis);
    put(131 + 8 * axis, step_m);
    put(179 + 16 * axis, most[k]);
    put(187 + 16 * axis, least[k]);
  }
  bytes.reserve(bytes.size() + extra.size() + record_bytes * points.size());
  bytes += extra;
  for (const LidarRecord& point : points) {
    for (const double coordinate : point.position_m)
      add_bytes(static_cast<std::int32_t>(std::lround(coordinate / step_m)), &bytes);
    add_bytes(intensity_in_16_bits(point.intensity), &bytes);
    add_bytes(std::uint8_t{0b001001}, &bytes);  // the first return of one
    add_bytes(std::uint8_t{0}, &bytes);         // classification: never classified
    add_bytes(std::uint32_t{0}, &bytes);        // scan angle, user data, source
    add_bytes(static_cast<double>(point.t_ns), &bytes);
    if (fields == LasFields::kAll) add_extra_bytes(point, &bytes);
  }
  return bytes;
}

std::uint64_t las_point_count(const std::filesystem::path& file) {
  constexpr std::uint64_t kMostBefore = 1 << 20;  // maximum bytes of the header and its records
  std::string bytes = read_head(file, kCountOffset14 + 8);
  if (!bytes.starts_with("LASF") || bytes.size() < kPointCountOffset + 4) return 0;
  std::uint64_t count = little_endian<std::uint32_t>(bytes, kPointCountOffset);
  if (count == 0 && bytes[25] == 4 && bytes.size() == kCountOffset14 + 8)
    count = little_endian<std::uint64_t>(bytes, kCountOffset14);
  const std::uint64_t begin = little_endian<std::uint32_t>(bytes, 96);
  if (begin > kMostBefore || count > kMaxLasPoints) return 0;
  std::uint64_t end = begin + count * little_endian<std::uint16_t>(bytes, 105);
  if (bytes[104] & 0x80) {  // compressed: the table of its chunks comes last
    bytes = read_head(file, begin + 8);
    if (bytes.size() < begin + 8) return 0;
    end = little_endian<std::uint64_t>(bytes, begin);
  }
  std::error_code error;
  const std::uintmax_t size = std::filesystem::file_size(file, error);
  return error || end > size ? 0 : count;
}

}  // namespace redrive
