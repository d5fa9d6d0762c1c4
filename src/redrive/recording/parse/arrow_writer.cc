// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/arrow_writer.h"

#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>
#include <string_view>

#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

constexpr std::size_t kAlignment = 8;
constexpr std::int16_t kVersion5 = 4;  // MetadataVersion of Schema.fbs, counted from 0

void align(std::string* bytes) {
  bytes->append((kAlignment - bytes->size() % kAlignment) % kAlignment, '\0');
}

std::string packed_by(arrow::Codec codec, const std::string& bytes) {
  std::string packed;
  if (codec == arrow::Codec::kLz4Frame) {
    packed.resize(LZ4F_compressFrameBound(bytes.size(), nullptr));
    packed.resize(
        LZ4F_compressFrame(packed.data(), packed.size(), bytes.data(), bytes.size(), nullptr));
  } else {
    packed.resize(ZSTD_compressBound(bytes.size()));
    packed.resize(ZSTD_compress(packed.data(), packed.size(), bytes.data(), bytes.size(), 1));
  }
  return packed;
}

/// Packs flags, one for each byte that is not 0.
std::string bits(std::string_view flags) {
  std::string bytes((flags.size() + 7) / 8, '\0');
  for (std::size_t i = 0; i < flags.size(); ++i)
    if (flags[i] != 0) bytes[i / 8] = static_cast<char>(bytes[i / 8] | 1 << i % 8);
  return bytes;
}

std::vector<std::string> words_of(std::vector<std::string> texts) {
  std::ranges::sort(texts);
  texts.erase(std::unique(texts.begin(), texts.end()), texts.end());
  return texts;
}

}  // namespace

void ArrowWriter::add(const std::string& name, const std::vector<bool>& values) {
  columns_.push_back({.name = name,
                      .kind = {arrow::Type::Bool},
                      .rows = values.size(),
                      .values = std::string(values.begin(), values.end())});
}

std::string ArrowWriter::bytes() {
  const std::string magic = "ARROW1";
  out_ = magic;
  align(&out_);
  {
    flatbuffers::FlatBufferBuilder builder;
    const auto fields = schema(&builder);
    body_.clear();
    write_message(&builder, arrow::Header::Schema, fields.Union());
  }
  std::vector<arrow::Block> dictionaries, batches;
  for (std::size_t c = 0; c < columns_.size(); ++c)
    if (columns_[c].by_dictionary) dictionaries.push_back(write_dictionary(c));
  const std::size_t rows = columns_.empty() ? 0 : columns_[0].rows;
  for (std::size_t b = 0; b < batches_; ++b) {
    begin_batch();
    const std::size_t from = rows * b / batches_, to = rows * (b + 1) / batches_;
    for (const Column& column : columns_) add_column(column, from, to);
    batches.push_back(write_batch(to - from, std::nullopt));
  }
  add_bytes(std::uint32_t{0xffffffff}, &out_);  // end of the stream
  add_bytes(std::uint32_t{0}, &out_);
  flatbuffers::FlatBufferBuilder builder;
  const auto fields = schema(&builder);
  const auto dictionary_blocks = builder.CreateVectorOfStructs(dictionaries),
             batch_blocks = builder.CreateVectorOfStructs(batches);
  builder.Finish(arrow::CreateFooter(builder, kVersion5, fields, dictionary_blocks, batch_blocks));
  out_.append(reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize());
  add_bytes(static_cast<std::int32_t>(builder.GetSize()), &out_);
  return std::move(out_) + magic;
}

flatbuffers::Offset<arrow::Schema> ArrowWriter::schema(flatbuffers::FlatBufferBuilder* to) const {
  const auto type_of = [&](const Kind& kind) {
    if (kind.type == arrow::Type::Int)
      return arrow::CreateInt(*to, kind.bits, kind.is_signed).Union();
    if (kind.type == arrow::Type::FloatingPoint)
      return arrow::CreateFloatingPoint(*to, kind.bits == 16   ? arrow::Precision::kHalf
                                             : kind.bits == 32 ? arrow::Precision::kSingle
                                                               : arrow::Precision::kDouble)
          .Union();
    return arrow::CreatePlain(*to).Union();
  };
  std::vector<flatbuffers::Offset<arrow::Field>> fields;
  for (std::size_t c = 0; c < columns_.size(); ++c) {
    const Column& column = columns_[c];
    const auto name = to->CreateString(column.name);
    const auto type = type_of(column.kind);
    flatbuffers::Offset<arrow::DictionaryEncoding> dictionary;
    if (column.by_dictionary)
      dictionary = arrow::CreateDictionaryEncoding(*to, static_cast<std::int64_t>(c),
                                                   arrow::CreateInt(*to, 8, true));
    // Arrow's own reader wants the list of children, though it is empty.
    const auto children = to->CreateVector(std::vector<flatbuffers::Offset<arrow::Field>>());
    fields.push_back(arrow::CreateField(*to, name, /*nullable=*/true, column.kind.type, type,
                                        dictionary, children));
  }
  return arrow::CreateSchema(*to, arrow::Endianness::kLittle, to->CreateVector(fields));
}

void ArrowWriter::begin_batch() {
  body_.clear();
  buffers_.clear();
  nodes_.clear();
}

void ArrowWriter::add_buffer(std::string bytes) {
  const std::size_t size = bytes.size();
  if (codec_ && size > 0) {
    constexpr std::int64_t kPlain = -1;
    const std::string packed = packed_by(*codec_, bytes);
    const bool is_shorter = packed.size() < size;
    std::string prefix;
    add_bytes(is_shorter ? static_cast<std::int64_t>(size) : kPlain, &prefix);
    bytes = prefix + (is_shorter ? packed : bytes);
  }
  buffers_.emplace_back(std::ssize(body_), std::ssize(bytes));
  body_ += bytes;
  align(&body_);
}

void ArrowWriter::add_texts(const std::vector<std::string>& texts) {
  std::string offsets, all;
  add_bytes(std::int32_t{0}, &offsets);
  for (const std::string& text : texts) {
    all += text;
    add_bytes(static_cast<std::int32_t>(all.size()), &offsets);
  }
  add_buffer(offsets);
  add_buffer(all);
}

void ArrowWriter::add_column(const Column& column, std::size_t from, std::size_t to) {
  const std::size_t rows = to - from;
  std::string valid(rows, 1);
  for (const std::size_t row : column.missing)
    if (row >= from && row < to) valid[row - from] = 0;
  nodes_.emplace_back(std::ssize(valid), std::ranges::count(valid, 0));
  add_buffer(column.missing.empty() ? "" : bits(valid));
  if (column.kind.type == arrow::Type::Utf8) {
    const auto first = column.texts.begin() + std::ptrdiff_t(from);
    const std::vector<std::string> texts(first, first + std::ptrdiff_t(rows));
    if (!column.by_dictionary) return add_texts(texts);
    const std::vector<std::string> words = words_of(column.texts);
    std::string indices;
    for (const std::string& text : texts)
      indices += static_cast<char>(std::ranges::lower_bound(words, text) - words.begin());
    return add_buffer(indices);
  }
  const std::size_t width = column.rows == 0 ? 0 : column.values.size() / column.rows;
  const std::string values = column.values.substr(from * width, rows * width);
  add_buffer(column.kind.type == arrow::Type::Bool ? bits(values) : values);
}

arrow::Block ArrowWriter::write_dictionary(std::size_t column) {
  begin_batch();
  const std::vector<std::string> words = words_of(columns_[column].texts);
  nodes_.emplace_back(std::ssize(words), 0);
  add_buffer("");
  add_texts(words);
  return write_batch(words.size(), static_cast<std::int64_t>(column));
}

arrow::Block ArrowWriter::write_batch(std::size_t rows, std::optional<std::int64_t> dictionary) {
  flatbuffers::FlatBufferBuilder builder;
  const auto compression = codec_ ? arrow::CreateCompression(builder, *codec_)
                                  : flatbuffers::Offset<arrow::Compression>();
  const auto nodes = builder.CreateVectorOfStructs(nodes_);
  const auto buffers = builder.CreateVectorOfStructs(buffers_);
  const auto record = arrow::CreateRecordBatch(builder, static_cast<std::int64_t>(rows), nodes,
                                               buffers, compression);
  if (!dictionary) return write_message(&builder, arrow::Header::RecordBatch, record.Union());
  return write_message(&builder, arrow::Header::DictionaryBatch,
                       arrow::CreateDictionaryBatch(builder, *dictionary, record).Union());
}

arrow::Block ArrowWriter::write_message(flatbuffers::FlatBufferBuilder* builder, arrow::Header type,
                                        flatbuffers::Offset<void> header) {
  builder->Finish(arrow::CreateMessage(*builder, kVersion5, type, header, std::ssize(body_)));
  std::string message(reinterpret_cast<const char*>(builder->GetBufferPointer()),
                      builder->GetSize());
  align(&message);
  const auto offset = std::ssize(out_);
  add_bytes(std::uint32_t{0xffffffff}, &out_);
  add_bytes(static_cast<std::int32_t>(message.size()), &out_);
  const auto metadata_bytes = static_cast<std::int32_t>(std::ssize(out_) - offset) +
                              static_cast<std::int32_t>(message.size());
  out_ += message + body_;
  return {offset, metadata_bytes, std::ssize(body_)};
}

}  // namespace redrive
