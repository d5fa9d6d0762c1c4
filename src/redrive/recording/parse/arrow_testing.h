// SPDX-License-Identifier: Apache-2.0
// Writes tables as Arrow's IPC files, for tests.
#pragma once

#include <lz4frame.h>
#include <zstd.h>

#include <Eigen/Core>

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "arrow_generated.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive::testing {

class ArrowFile {
 public:
  /// Buffers are packed by the codec. `batches`: rows are spread over as many.
  explicit ArrowFile(std::optional<arrow::Codec> codec = arrow::Codec::kLz4Frame,
                     std::size_t batches = 1)
      : codec_(codec), batches_(batches) {}

  void add(const std::string& name, const std::vector<double>& values) {
    add_numbers(name, {arrow::Type::FloatingPoint, 64, true}, values);
  }
  void add(const std::string& name, const std::vector<float>& values) {
    add_numbers(name, {arrow::Type::FloatingPoint, 32, true}, values);
  }
  /// Values that 16 bits hold stay exact.
  void add(const std::string& name, const std::vector<Eigen::half>& values) {
    add_numbers(name, {arrow::Type::FloatingPoint, 16, true}, values);
  }
  template <class T>
  requires std::is_integral_v<T>
  void add(const std::string& name, const std::vector<T>& values) {
    add_numbers(name, {arrow::Type::Int, 8 * sizeof(T), std::is_signed_v<T>}, values);
  }
  void add(const std::string& name, const std::vector<bool>& values) {
    Column column{name, {arrow::Type::Bool}, {}, values.size()};
    for (const bool value : values) column.cells.emplace_back(1, static_cast<char>(value));
    columns_.push_back(std::move(column));
  }
  void add(const std::string& name, const std::vector<std::string>& values) {
    columns_.push_back({name, {arrow::Type::Utf8}, values, values.size()});
  }
  /// A column of a type without parameters whose values are 8 bytes each.
  void add_other(const std::string& name, arrow::Type type, std::size_t rows) {
    columns_.push_back({name, {type}, std::vector<std::string>(rows, std::string(8, '\0')), rows});
  }
  /// The last column's rows without a value; bytes stay.
  void leave_out(const std::vector<std::size_t>& rows) { columns_.back().missing = rows; }
  /// Replaces the last column's texts by indices into a dictionary.
  void make_dictionary() { columns_.back().by_dictionary = true; }

  std::string bytes() {
    out_ = "ARROW1";
    out_.append(2, '\0');
    dictionaries_.clear();
    blocks_.clear();
    for (std::size_t c = 0; c < columns_.size(); ++c)
      if (columns_[c].by_dictionary) write_dictionary(c);
    const std::size_t rows = columns_.empty() ? 0 : columns_[0].rows;
    for (std::size_t b = 0; b < batches_; ++b) {
      begin_batch();
      const std::size_t from = rows * b / batches_, to = rows * (b + 1) / batches_;
      for (const Column& column : columns_) add_column(column, from, to);
      blocks_.push_back(write_batch(to - from, std::nullopt));
    }
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(arrow::CreateFooter(builder, 4, schema(&builder),
                                       builder.CreateVectorOfStructs(dictionaries_),
                                       builder.CreateVectorOfStructs(blocks_)));
    out_.append(reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize());
    add_bytes(static_cast<std::int32_t>(builder.GetSize()), &out_);
    return out_ + "ARROW1";
  }

 private:
  struct Kind {
    arrow::Type type;
    std::size_t bits = 0;
    bool is_signed = false;
  };
  struct Column {
    std::string name;
    Kind kind;
    std::vector<std::string> cells;
    std::size_t rows = 0;
    std::vector<std::size_t> missing = {};
    bool by_dictionary = false;
    std::vector<std::string> words() const {
      std::vector<std::string> all = cells;
      std::ranges::sort(all);
      all.erase(std::unique(all.begin(), all.end()), all.end());
      return all;
    }
  };

  template <class T>
  void add_numbers(const std::string& name, Kind kind, const std::vector<T>& values) {
    Column column{name, kind, {}, values.size()};
    for (const T& value : values) {
      column.cells.emplace_back();
      add_bytes(value, &column.cells.back());
    }
    columns_.push_back(std::move(column));
  }

  flatbuffers::Offset<void> type_of(const Kind& kind, flatbuffers::FlatBufferBuilder* to) const {
    if (kind.type == arrow::Type::Int)
      return arrow::CreateInt(*to, static_cast<int>(kind.bits), kind.is_signed).Union();
    if (kind.type == arrow::Type::FloatingPoint)
      return arrow::CreateFloatingPoint(*to, kind.bits == 16   ? arrow::Precision::kHalf
                                             : kind.bits == 32 ? arrow::Precision::kSingle
                                                               : arrow::Precision::kDouble)
          .Union();
    return arrow::CreatePlain(*to).Union();
  }
  flatbuffers::Offset<arrow::Schema> schema(flatbuffers::FlatBufferBuilder* to) const {
    std::vector<flatbuffers::Offset<arrow::Field>> fields;
    for (std::size_t c = 0; c < columns_.size(); ++c) {
      const auto name = to->CreateString(columns_[c].name);
      const auto type = type_of(columns_[c].kind, to);
      flatbuffers::Offset<arrow::DictionaryEncoding> dictionary;
      if (columns_[c].by_dictionary)
        dictionary = arrow::CreateDictionaryEncoding(*to, static_cast<std::int64_t>(c),
                                                     arrow::CreateInt(*to, 8, true));
      fields.push_back(
          arrow::CreateField(*to, name, true, columns_[c].kind.type, type, dictionary));
    }
    return arrow::CreateSchema(*to, arrow::Endianness::kLittle, to->CreateVector(fields));
  }

  void begin_batch() {
    body_.clear();
    buffers_.clear();
    nodes_.clear();
  }
  void add_buffer(std::string bytes) {
    const std::size_t size = bytes.size();
    if (codec_ && size > 0) {
      std::string packed;
      if (*codec_ == arrow::Codec::kLz4Frame) {
        packed.resize(LZ4F_compressFrameBound(size, nullptr));
        packed.resize(
            LZ4F_compressFrame(packed.data(), packed.size(), bytes.data(), size, nullptr));
      } else {
        packed.resize(ZSTD_compressBound(size));
        packed.resize(ZSTD_compress(packed.data(), packed.size(), bytes.data(), size, 1));
      }
      const bool is_shorter = packed.size() < size;
      std::string prefix;
      add_bytes(is_shorter ? static_cast<std::int64_t>(size) : std::int64_t{-1}, &prefix);
      bytes = prefix + (is_shorter ? packed : bytes);
    }
    buffers_.emplace_back(std::ssize(body_), std::ssize(bytes));
    body_ += bytes;
    body_.append((8 - body_.size() % 8) % 8, '\0');
  }
  static std::string bits(const std::vector<bool>& values) {
    std::string bytes((values.size() + 7) / 8, '\0');
    for (std::size_t i = 0; i < values.size(); ++i)
      if (values[i]) bytes[i / 8] = static_cast<char>(bytes[i / 8] | 1 << i % 8);
    return bytes;
  }
  void add_texts(const std::vector<std::string>& texts) {
    std::string offsets, all;
    add_bytes(std::int32_t{0}, &offsets);
    for (const std::string& text : texts) {
      all += text;
      add_bytes(static_cast<std::int32_t>(all.size()), &offsets);
    }
    add_buffer(offsets);
    add_buffer(all);
  }
  void add_column(const Column& column, std::size_t from, std::size_t to) {
    const std::vector<std::string> cells(column.cells.begin() + std::ptrdiff_t(from),
                                         column.cells.begin() + std::ptrdiff_t(to));
    std::vector<bool> valid(to - from, true);
    for (const std::size_t row : column.missing)
      if (row >= from && row < to) valid[row - from] = false;
    nodes_.emplace_back(std::ssize(cells), std::ssize(column.missing));
    add_buffer(column.missing.empty() ? "" : bits(valid));
    if (column.by_dictionary) {
      const std::vector<std::string> words = column.words();
      std::string indices;
      for (const std::string& cell : cells)
        indices += static_cast<char>(std::ranges::lower_bound(words, cell) - words.begin());
      add_buffer(indices);
    } else if (column.kind.type == arrow::Type::Utf8) {
      add_texts(cells);
    } else if (column.kind.type == arrow::Type::Bool) {
      std::vector<bool> values;
      for (const std::string& cell : cells) values.push_back(cell[0] != 0);
      add_buffer(bits(values));
    } else {
      std::string all;
      for (const std::string& cell : cells) all += cell;
      add_buffer(all);
    }
  }
  void write_dictionary(std::size_t c) {
    begin_batch();
    const std::vector<std::string> words = columns_[c].words();
    nodes_.emplace_back(std::ssize(words), 0);
    add_buffer("");
    add_texts(words);
    dictionaries_.push_back(write_batch(words.size(), static_cast<std::int64_t>(c)));
  }
  arrow::Block write_batch(std::size_t rows, std::optional<std::int64_t> dictionary) {
    flatbuffers::FlatBufferBuilder builder;
    const auto compression = codec_ ? arrow::CreateCompression(builder, *codec_)
                                    : flatbuffers::Offset<arrow::Compression>();
    const auto record = arrow::CreateRecordBatch(
        builder, static_cast<std::int64_t>(rows), builder.CreateVectorOfStructs(nodes_),
        builder.CreateVectorOfStructs(buffers_), compression);
    const auto header = dictionary
                            ? arrow::CreateDictionaryBatch(builder, *dictionary, record).Union()
                            : record.Union();
    builder.Finish(arrow::CreateMessage(
        builder, 4, dictionary ? arrow::Header::DictionaryBatch : arrow::Header::RecordBatch,
        header, std::ssize(body_)));
    std::string message(reinterpret_cast<const char*>(builder.GetBufferPointer()),
                        builder.GetSize());
    message.append((8 - message.size() % 8) % 8, '\0');
    const auto offset = std::ssize(out_);
    add_bytes(std::uint32_t{0xffffffff}, &out_);
    add_bytes(static_cast<std::int32_t>(message.size()), &out_);
    out_ += message + body_;
    return {offset, static_cast<std::int32_t>(message.size() + 8), std::ssize(body_)};
  }

  std::optional<arrow::Codec> codec_;
  std::size_t batches_;
  std::vector<Column> columns_;
  std::string out_, body_;
  std::vector<arrow::Buffer> buffers_;
  std::vector<arrow::FieldNode> nodes_;
  std::vector<arrow::Block> dictionaries_, blocks_;
};

}  // namespace redrive::testing
