// SPDX-License-Identifier: Apache-2.0
// Writes tables as Arrow's IPC files, which are Feather, version 2.
// https://arrow.apache.org/docs/format/Columnar.html
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include <Eigen/Core>

#include "arrow_generated.h"

namespace redrive {

/// Columns have the same number of rows and names of their own.
class ArrowWriter {
 public:
  /// `codec`: packs the buffers. `batches`: number of record batches that share the rows.
  explicit ArrowWriter(std::optional<arrow::Codec> codec = arrow::Codec::kLz4Frame,
                       std::size_t batches = 1)
      : codec_(codec), batches_(batches) {}

  /// Adds a column of integers, double, float or Eigen::half.
  template <class T>
  void add(const std::string& name, const std::vector<T>& values) {
    columns_.push_back(
        {.name = name,
         .kind = kind_of<T>(),
         .rows = values.size(),
         .values = {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)}});
  }
  void add(const std::string& name, const std::vector<bool>& values);
  void add(const std::string& name, const std::vector<std::string>& values) {
    columns_.push_back(
        {.name = name, .kind = {arrow::Type::Utf8}, .rows = values.size(), .texts = values});
  }

  /// Returns the file.
  std::string bytes();

 protected:
  struct Kind {
    arrow::Type type = arrow::Type::NONE;
    int bits = 0;
    bool is_signed = false;
  };
  struct Column {
    std::string name;
    Kind kind;
    std::size_t rows = 0;
    std::string values = {};                ///< a value for each row; booleans have a byte here
    std::vector<std::string> texts = {};    ///< in place of values
    std::vector<std::size_t> missing = {};  ///< rows without a value
    bool by_dictionary = false;             ///< texts are written as indices, of 8 bits, into words
  };
  std::vector<Column> columns_;

 private:
  template <class T>
  static Kind kind_of() {
    if constexpr (std::is_integral_v<T>)
      return {arrow::Type::Int, 8 * int{sizeof(T)}, std::is_signed_v<T>};
    else
      return {arrow::Type::FloatingPoint, 8 * int{sizeof(T)}};
  }
  flatbuffers::Offset<arrow::Schema> schema(flatbuffers::FlatBufferBuilder* to) const;
  void begin_batch();
  void add_buffer(std::string bytes);
  void add_texts(const std::vector<std::string>& texts);
  void add_column(const Column& column, std::size_t from, std::size_t to);
  /// Writes the rows as one batch, or as the words of a dictionary.
  arrow::Block write_batch(std::size_t rows, std::optional<std::int64_t> dictionary);
  arrow::Block write_dictionary(std::size_t column);
  /// Writes the metadata of a message.
  arrow::Block write_message(flatbuffers::FlatBufferBuilder* builder, arrow::Header type,
                             flatbuffers::Offset<void> header);

  std::optional<arrow::Codec> codec_;
  std::size_t batches_;
  std::string out_, body_;
  std::vector<arrow::Buffer> buffers_;
  std::vector<arrow::FieldNode> nodes_;
};

}  // namespace redrive
