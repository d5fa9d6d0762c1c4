// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/ply.h"

#include <charconv>
#include <cmath>
#include <map>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/recording/little_endian.h"

namespace redrive {
namespace {

constexpr std::size_t kMaxPlyPoints = 100'000'000;
constexpr double kMaxPlyCoordinate_m = 1e6;

/// Sizes in bytes of the scalar types, under both names.
const std::map<std::string_view, std::size_t> kSizes = {
    {"char", 1},   {"int8", 1},    {"uchar", 1},  {"uint8", 1},  {"short", 2}, {"int16", 2},
    {"ushort", 2}, {"uint16", 2},  {"int", 4},    {"int32", 4},  {"uint", 4},  {"uint32", 4},
    {"float", 4},  {"float32", 4}, {"double", 8}, {"float64", 8}};

class PlyFile {
 public:
  PlyFile(std::string_view bytes, const std::filesystem::path& file) : rest_(bytes), file_(file) {
    read_header();
  }

  std::vector<Eigen::Vector3d> points() {
    std::vector<Eigen::Vector3d> points;
    if (!ascii_ && count_ > rest_.size() / record_bytes_)
      refuse("element vertex", std::to_string(count_),
             "of " + std::to_string(record_bytes_) + " bytes each do not fit in the " +
                 std::to_string(rest_.size()) + " that follow (truncated?)");
    if (ascii_ && count_ > rest_.size() / 2)  // at least a digit and a line end each
      refuse("element vertex", std::to_string(count_),
             "do not fit in the " + std::to_string(rest_.size()) + " bytes that follow");
    points.reserve(count_);
    for (std::size_t i = 0; i < count_; ++i)
      points.push_back(ascii_ ? ascii_point(i) : binary_point(i));
    return points;
  }

 private:
  struct Property {
    std::string_view name;
    std::size_t size, offset;
  };

  [[noreturn]] void refuse(const std::string& field, std::string_view value,
                           const std::string& rule) const {
    throw InputError(file_, field, value.substr(0, 80), rule);
  }

  std::string_view next_line() {
    const std::size_t end = rest_.find('\n');
    if (end == std::string_view::npos) refuse("", "", "ends too early (truncated?)");
    std::string_view line = rest_.substr(0, end);
    rest_.remove_prefix(end + 1);
    if (line.ends_with('\r')) line.remove_suffix(1);
    return line;
  }
  static std::string_view next_word(std::string_view* line) {
    line->remove_prefix(std::min(line->find_first_not_of(" \t"), line->size()));
    const std::string_view word = line->substr(0, line->find_first_of(" \t"));
    line->remove_prefix(word.size());
    return word;
  }

  void read_header() {
    if (next_line() != "ply") refuse("", "", "does not begin with a line \"ply\": no PLY file");
    std::string_view element;
    bool format_given = false;
    for (;;) {
      const std::string_view whole = next_line();
      std::string_view line = whole;
      const std::string_view keyword = next_word(&line);
      if (keyword == "end_header") break;
      if (keyword == "comment" || keyword == "obj_info") continue;
      if (keyword == "format") {
        const std::string_view format = next_word(&line);
        ascii_ = format == "ascii";
        format_given = true;
        if ((!ascii_ && format != "binary_little_endian") || next_word(&line) != "1.0")
          refuse("format", whole, "must be ascii 1.0 or binary_little_endian 1.0");
      } else if (keyword == "element") {
        if (element.empty() && !line.starts_with(" vertex"))
          refuse("element", whole, "the first must be vertex");
        element = next_word(&line);
        if (element == "vertex") {
          const std::string_view digits = next_word(&line);
          const auto [end, error] =
              std::from_chars(digits.data(), digits.data() + digits.size(), count_);
          if (error != std::errc() || end != digits.data() + digits.size() ||
              count_ > kMaxPlyPoints || !properties_.empty())
            refuse("element", whole, "must give a number of points up to 1e8, once");
        }
      } else if (keyword == "property") {
        if (element != "vertex") continue;
        const std::string_view type = next_word(&line), name = next_word(&line);
        const auto size = kSizes.find(type);
        if (size == kSizes.end() || name.empty())
          refuse("property", whole, "of a vertex must be a scalar type and a name");
        if ((name == "x" || name == "y" || name == "z") && !type.starts_with("float") &&
            !type.starts_with("double"))
          refuse("property", whole, "must be float or double");
        properties_.push_back({name, size->second, record_bytes_});
        record_bytes_ += size->second;
      } else {
        refuse("header", whole,
               "is none of format, element, property, comment, obj_info, end_header");
      }
    }
    if (!format_given) refuse("format", "", "missing");
    for (int axis = 0; axis < 3; ++axis) {
      const std::string name(1, "xyz"[axis]);
      for (std::size_t p = 0; p < properties_.size(); ++p) {
        if (properties_[p].name != name) continue;
        if (axes_[axis] != kNone) refuse("property", name, "is there twice");
        axes_[axis] = p;
      }
      if (axes_[axis] == kNone) refuse("property", name, "missing");
    }
  }

  Eigen::Vector3d binary_point(std::size_t index) const {
    Eigen::Vector3d point;
    for (int axis = 0; axis < 3; ++axis) {
      const Property& property = properties_[axes_[axis]];
      const std::size_t at = index * record_bytes_ + property.offset;
      point[axis] =
          property.size == 4 ? little_endian<float>(rest_, at) : little_endian<double>(rest_, at);
    }
    return checked(point, index);
  }

  Eigen::Vector3d ascii_point(std::size_t index) {
    const std::string_view whole = next_line();
    std::string_view line = whole;
    Eigen::Vector3d point;
    for (std::size_t p = 0; p < properties_.size(); ++p) {
      const std::string_view word = next_word(&line);
      double value = 0;
      const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
      if (word.empty() || error != std::errc() || end != word.data() + word.size())
        refuse("vertex " + std::to_string(index), whole,
               "must have " + std::to_string(properties_.size()) + " numbers");
      for (int axis = 0; axis < 3; ++axis)
        if (axes_[axis] == p) point[axis] = value;
    }
    if (!next_word(&line).empty())
      refuse("vertex " + std::to_string(index), whole,
             "must have " + std::to_string(properties_.size()) + " numbers");
    return checked(point, index);
  }

  Eigen::Vector3d checked(const Eigen::Vector3d& point, std::size_t index) const {
    for (int axis = 0; axis < 3; ++axis)
      if (!(std::abs(point[axis]) <= kMaxPlyCoordinate_m))
        refuse("vertex " + std::to_string(index) + " " + "xyz"[axis], std::to_string(point[axis]),
               "must be metres, at most 1e6");
    return point;
  }

  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  std::string_view rest_;
  std::filesystem::path file_;
  bool ascii_ = false;
  std::size_t count_ = 0, record_bytes_ = 0;
  std::vector<Property> properties_;
  std::size_t axes_[3] = {kNone, kNone, kNone};
};

}  // namespace

std::vector<Eigen::Vector3d> parse_ply(std::string_view bytes, const std::filesystem::path& file) {
  return PlyFile(bytes, file).points();
}

std::vector<Eigen::Vector3d> read_ply(const std::filesystem::path& file) {
  return parse_ply(read_file(file), file);
}

std::string make_ply(std::span<const PlyPoint> points, bool normals,
                     std::span<const Triangle> triangles) {
  std::string bytes = "ply\nformat binary_little_endian 1.0\nelement vertex " +
                      std::to_string(points.size()) + "\n";
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"})
    if (name[0] != 'n' || normals) bytes += std::string("property float ") + name + "\n";
  for (const char* name : {"red", "green", "blue"})
    bytes += std::string("property uchar ") + name + "\n";
  if (!triangles.empty())
    bytes += "element face " + std::to_string(triangles.size()) +
             "\nproperty list uchar int vertex_indices\n";
  bytes += "end_header\n";
  const auto add = [&](const void* data, std::size_t size) {
    bytes.append(static_cast<const char*>(data), size);
  };
  for (const PlyPoint& point : points) {
    add(point.position.data(), 3 * sizeof(float));
    if (normals) add(point.normal.data(), 3 * sizeof(float));
    add(point.rgb.data(), point.rgb.size());
  }
  for (const Triangle& triangle : triangles) {
    bytes += static_cast<char>(triangle.size());
    add(triangle.data(), sizeof triangle);
  }
  return bytes;
}

}  // namespace redrive
