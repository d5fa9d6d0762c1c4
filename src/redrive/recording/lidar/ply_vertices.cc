// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/ply_vertices.h"

#include <algorithm>
#include <charconv>
#include <map>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

/// Sizes in bytes of the scalar types, under both names.
const std::map<std::string_view, std::size_t> kSizes = {
    {"char", 1},   {"int8", 1},    {"uchar", 1},  {"uint8", 1},  {"short", 2}, {"int16", 2},
    {"ushort", 2}, {"uint16", 2},  {"int", 4},    {"int32", 4},  {"uint", 4},  {"uint32", 4},
    {"float", 4},  {"float32", 4}, {"double", 8}, {"float64", 8}};

std::string_view next_word(std::string_view* line) {
  line->remove_prefix(std::min(line->find_first_not_of(" \t"), line->size()));
  const std::string_view word = line->substr(0, line->find_first_of(" \t"));
  line->remove_prefix(word.size());
  return word;
}

}  // namespace

PlyVertices::PlyVertices(std::string_view bytes, std::filesystem::path file, std::size_t most)
    : rest_(bytes), file_(std::move(file)) {
  read_header(most);
  if (!ascii_ && record_bytes_ > 0 && count_ > rest_.size() / record_bytes_)
    fail("element vertex", std::to_string(count_),
         "of " + std::to_string(record_bytes_) + " bytes each do not fit in the " +
             std::to_string(rest_.size()) + " that follow (truncated?)");
  if (ascii_ && count_ > rest_.size() / 2)  // at least a digit and a line end each
    fail("element vertex", std::to_string(count_),
         "do not fit in the " + std::to_string(rest_.size()) + " bytes that follow");
}

void PlyVertices::fail(const std::string& field, std::string_view value,
                       const std::string& rule) const {
  throw InputError(file_, field, value.substr(0, 80), rule);
}

std::string_view PlyVertices::next_line() {
  const std::size_t end = rest_.find('\n');
  if (end == std::string_view::npos) fail("", "", "ends too early (truncated?)");
  std::string_view line = rest_.substr(0, end);
  rest_.remove_prefix(end + 1);
  if (line.ends_with('\r')) line.remove_suffix(1);
  return line;
}

void PlyVertices::read_header(std::size_t most) {
  if (next_line() != "ply") fail("", "", "does not begin with a line \"ply\": no PLY file");
  std::string_view element;
  std::vector<Element> before;
  bool format_given = false, vertices_given = false;
  for (;;) {
    const std::string_view whole = next_line();
    std::string_view line = whole;
    const std::string_view keyword = next_word(&line);
    if (keyword == "end_header") break;
    if (keyword == "obj_info") continue;
    if (keyword == "comment") {
      line.remove_prefix(std::min(line.find_first_not_of(" \t"), line.size()));
      comments_.emplace_back(line);
    } else if (keyword == "format") {
      const std::string_view format = next_word(&line);
      ascii_ = format == "ascii";
      big_endian_ = format == "binary_big_endian";
      format_given = true;
      if ((!ascii_ && !big_endian_ && format != "binary_little_endian") ||
          next_word(&line) != "1.0")
        fail("format", whole,
             "must be ascii 1.0, binary_little_endian 1.0 or binary_big_endian 1.0");
    } else if (keyword == "element") {
      element = next_word(&line);
      if (element == "vertex") {
        if (vertices_given) fail("element", whole, "is there twice");
        vertices_given = true;
        count_ = count_of(next_word(&line), whole, most);
      } else if (!vertices_given) {
        before.push_back({count_of(next_word(&line), whole, rest_.size()), {}});
      }
    } else if (keyword == "property") {
      std::string_view type = next_word(&line);
      if (element != "vertex") {
        if (vertices_given || before.empty()) continue;
        Element::Property property;
        if (type == "list") {
          const auto size = kSizes.find(next_word(&line));
          if (size == kSizes.end() || size->second > 4)
            fail("property", whole, "must have an integer type for the length of its list");
          property.count_bytes = size->second;
          type = next_word(&line);
        }
        const auto size = kSizes.find(type);
        if (size == kSizes.end()) fail("property", whole, "must have a scalar type");
        property.bytes = size->second;
        before.back().properties.push_back(property);
        continue;
      }
      const std::string_view name = next_word(&line);
      const auto size = kSizes.find(type);
      if (size == kSizes.end() || name.empty())
        fail("property", whole, "of a vertex must be a scalar type and a name");
      properties_.push_back({name, type, size->second, record_bytes_});
      record_bytes_ += size->second;
    } else {
      fail("header", whole, "is none of format, element, property, comment, obj_info, end_header");
    }
  }
  if (!format_given) fail("format", "", "missing");
  if (!vertices_given) fail("element vertex", "", "missing");
  for (const Element& of : before) skip(of);
}

std::size_t PlyVertices::count_of(std::string_view digits, std::string_view line,
                                  std::size_t most) const {
  std::size_t count = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), count);
  if (error != std::errc() || end != digits.data() + digits.size() || count > most)
    fail("element", line, "must give a number of points up to " + std::to_string(most));
  return count;
}

void PlyVertices::skip(const Element& element) {
  const auto skip_bytes = [&](std::size_t bytes) {
    if (bytes > rest_.size()) fail("", "", "ends before its vertices (truncated?)");
    const std::string_view skipped = rest_.substr(0, bytes);
    rest_.remove_prefix(bytes);
    return skipped;
  };
  for (std::size_t i = 0; i < element.count && !element.properties.empty(); ++i) {
    if (ascii_) {
      next_line();
      continue;
    }
    for (const Element::Property& property : element.properties) {
      std::size_t values = 1;
      if (property.count_bytes > 0) {
        values = 0;
        const std::string_view count = skip_bytes(property.count_bytes);
        for (std::size_t k = 0; k < count.size(); ++k)
          values = values << 8 |
                   static_cast<unsigned char>(count[big_endian_ ? k : count.size() - 1 - k]);
      }
      skip_bytes(values * property.bytes);
    }
  }
}

bool PlyVertices::has(std::string_view property) const {
  return std::ranges::find(properties_, property, &Property::name) != properties_.end();
}

std::vector<std::size_t> PlyVertices::columns_of(std::span<const std::string> names) const {
  std::vector<std::size_t> columns;
  for (const std::string& name : names) {
    const auto found = std::ranges::find(properties_, name, &Property::name);
    if (found == properties_.end()) fail("property", name, "missing");
    if (std::find_if(found + 1, properties_.end(), [&](const Property& other) {
          return other.name == name;
        }) != properties_.end())
      fail("property", name, "is there twice");
    if (!found->type.starts_with("float") && !found->type.starts_with("double"))
      fail("property", std::string(found->type) + " " + name, "must be float or double");
    columns.push_back(static_cast<std::size_t>(found - properties_.begin()));
  }
  return columns;
}

void PlyVertices::read(
    std::span<const std::string> names,
    const std::function<void(std::size_t index, std::span<const double> values)>& take) {
  const std::vector<std::size_t> columns = columns_of(names);
  std::vector<double> values(names.size()), of_all(properties_.size());
  for (std::size_t i = 0; i < count_; ++i) {
    if (ascii_) {
      read_ascii(i, of_all);
      for (std::size_t k = 0; k < columns.size(); ++k) values[k] = of_all[columns[k]];
    } else {
      read_binary(i, columns, values);
    }
    take(i, values);
  }
}

void PlyVertices::read_binary(std::size_t index, const std::vector<std::size_t>& columns,
                              std::span<double> values) const {
  for (std::size_t k = 0; k < columns.size(); ++k) {
    const Property& property = properties_[columns[k]];
    std::string bytes(rest_.substr(index * record_bytes_ + property.offset, property.size));
    if (big_endian_) std::ranges::reverse(bytes);
    values[k] =
        property.size == 4 ? little_endian<float>(bytes, 0) : little_endian<double>(bytes, 0);
  }
}

void PlyVertices::read_ascii(std::size_t index, std::span<double> of_all) {
  const std::string_view whole = next_line();
  std::string_view line = whole;
  const auto refuse = [&] {
    fail("vertex " + std::to_string(index), whole,
         "must have " + std::to_string(of_all.size()) + " numbers");
  };
  for (double& value : of_all) {
    const std::string_view word = next_word(&line);
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (word.empty() || error != std::errc() || end != word.data() + word.size()) refuse();
  }
  if (!next_word(&line).empty()) refuse();
}

}  // namespace redrive
