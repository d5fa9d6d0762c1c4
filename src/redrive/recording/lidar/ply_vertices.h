// SPDX-License-Identifier: Apache-2.0
// The vertices of PLY 1.0 files (ply.h), ascii or binary of either byte order, with any scalar
// properties.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace redrive {

class PlyVertices {
 public:
  /// Reads the header; `bytes` must outlive the object. InputError for other versions and formats,
  /// damaged headers, and more than `most` vertices.
  PlyVertices(std::string_view bytes, std::filesystem::path file, std::size_t most);

  std::size_t size() const { return count_; }
  bool has(std::string_view property) const;
  /// Lines of comments, without the keyword and the blanks after it.
  const std::vector<std::string>& comments() const { return comments_; }

  /// Calls take(index, values) for each vertex: the named properties, as many as names. InputError
  /// where a property is missing, there twice or neither float nor double, and for truncated files.
  void read(std::span<const std::string> names,
            const std::function<void(std::size_t index, std::span<const double> values)>& take);

  [[noreturn]] void fail(const std::string& field, std::string_view value,
                         const std::string& rule) const;

 private:
  struct Property {
    std::string_view name, type;
    std::size_t size, offset;
  };

  /// An element before the vertices: the records to be skipped.
  struct Element {
    struct Property {
      /// bytes of a list's length, 0: no list; bytes of one value
      std::size_t count_bytes = 0, bytes = 0;
    };
    std::size_t count = 0;
    std::vector<Property> properties;
  };

  std::string_view next_line();
  void read_header(std::size_t most);
  void skip(const Element& element);
  std::size_t count_of(std::string_view digits, std::string_view line, std::size_t most) const;
  std::vector<std::size_t> columns_of(std::span<const std::string> names) const;
  void read_binary(std::size_t index, const std::vector<std::size_t>& columns,
                   std::span<double> values) const;
  void read_ascii(std::size_t index, std::span<double> of_all);

  std::string_view rest_;
  std::filesystem::path file_;
  bool ascii_ = false, big_endian_ = false;
  std::size_t count_ = 0, record_bytes_ = 0;
  std::vector<Property> properties_;
  std::vector<std::string> comments_;
};

}  // namespace redrive
