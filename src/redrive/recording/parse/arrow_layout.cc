// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/arrow_layout.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>

#include "redrive/base/error.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using arrow::Type;

constexpr std::string_view kMagic = "ARROW1";
constexpr std::uint64_t kEndBytes = 10;  // i32 length of the footer, magic
constexpr std::uint64_t kMaxMetadataBytes = 1 << 24;
// Rows that a file may claim: packed zeros take next to no bytes, rows of a recording ten or more.
constexpr std::uint64_t kFirstRows = 1 << 16, kRowsOfByte = 16;
constexpr std::uint32_t kContinuation = 0xffffffff;  // before the length of a message
constexpr int kMaxNesting = 32;

/// Structs of a message may lie at any byte.
template <class Struct, class Take>
void for_each(const flatbuffers::Vector<const Struct*>* structs, const Take& take) {
  if (!structs) return;
  for (std::size_t i = 0; i < structs->size(); ++i) {
    std::array<std::byte, sizeof(Struct)> bytes;
    std::memcpy(bytes.data(), structs->Data() + i * sizeof(Struct), sizeof(Struct));
    take(std::bit_cast<Struct>(bytes));
  }
}

class LayoutReader {
 public:
  LayoutReader(const ReadAt& read, std::uint64_t file_bytes, const std::filesystem::path& file)
      : read_(read), size_(file_bytes), most_rows_(kFirstRows + kRowsOfByte * file_bytes) {
    out_.file = file;
  }

  ArrowLayout read() {
    const std::string footer_bytes = read_footer();
    const auto& footer = *flatbuffers::GetRoot<arrow::Footer>(footer_bytes.data());
    const arrow::Schema* schema = footer.schema();
    if (!schema || !schema->fields()) fail("footer", "", "has no schema");
    if (schema->endianness() != arrow::Endianness::kLittle)
      fail("schema", "", "has big-endian numbers");
    for (const arrow::Field* field : *schema->fields()) add_column(*field);
    for_each(footer.dictionaries(), [&](const arrow::Block& block) { add_dictionary(block); });
    for_each(footer.batches(), [&](const arrow::Block& block) { add_batch(block); });
    return std::move(out_);
  }

 private:
  [[noreturn]] void fail(const std::string& field, const std::string& value,
                         const std::string& rule) const {
    throw InputError(out_.file, field, value, rule);
  }

  template <class Root>
  void verify(const std::string& bytes, std::size_t from, const char* what) const {
    flatbuffers::Verifier verifier(reinterpret_cast<const std::uint8_t*>(bytes.data()) + from,
                                   bytes.size() - from, kMaxNesting);
    if (!verifier.VerifyBuffer<Root>(nullptr)) fail(what, "", "is damaged");
  }

  std::string read_footer() {
    if (size_ >= 4 && read_(0, 4) == "FEA1")
      fail("", "", "is Feather, version 1; version 2 is read");
    if (size_ < kMagic.size() + kEndBytes || read_(0, kMagic.size()) != kMagic)
      fail("", "", "is no Arrow file: does not begin with ARROW1");
    const std::string end = read_(size_ - kEndBytes, kEndBytes);
    if (!end.ends_with(kMagic)) fail("", "", "does not end with ARROW1 (truncated?)");
    const auto bytes = little_endian<std::int32_t>(end, 0);
    if (bytes < 4 ||
        std::uint64_t(bytes) > std::min(kMaxMetadataBytes, size_ - kEndBytes - kMagic.size()))
      fail("length of the footer", std::to_string(bytes), "does not fit into the file");
    std::string footer = read_(size_ - kEndBytes - std::uint64_t(bytes), std::uint64_t(bytes));
    verify<arrow::Footer>(footer, 0, "footer");
    return footer;
  }

  ArrowLayout::Integer integer_of(const arrow::Int& type, const std::string& column) const {
    if (type.bits() != 8 && type.bits() != 16 && type.bits() != 32 && type.bits() != 64)
      fail(column, std::to_string(type.bits()) + " bits", "integers have 8, 16, 32 or 64");
    return {static_cast<std::size_t>(type.bits()) / 8, type.is_signed()};
  }

  /// Number of buffers of a column with its children, in the order in which they lie.
  std::size_t buffers_of(const arrow::Field& field, const std::string& column) const {
    if (field.dictionary()) return 2;
    std::size_t buffers = 0;
    switch (field.type_type()) {
      case Type::Null: break;
      case Type::Int:
      case Type::FloatingPoint:
      case Type::Bool:
      case Type::Decimal:
      case Type::Date:
      case Type::Time:
      case Type::Timestamp:
      case Type::Interval:
      case Type::Duration:
      case Type::FixedSizeBinary:
      case Type::List:
      case Type::LargeList:
      case Type::Map: buffers = 2; break;
      case Type::Utf8:
      case Type::Binary:
      case Type::LargeUtf8:
      case Type::LargeBinary: buffers = 3; break;
      case Type::Struct:
      case Type::FixedSizeList: buffers = 1; break;
      default:  // the columns behind it cannot be found
        fail(column, arrow::EnumNameType(field.type_type()), "a type that is not read");
    }
    if (field.children())
      for (const arrow::Field* child : *field.children()) buffers += buffers_of(*child, column);
    return buffers;
  }

  void add_column(const arrow::Field& field) {
    ArrowLayout::Column column;
    column.name = field.name() ? field.name()->str() : "";
    column.type = field.type_type();
    column.first_buffer = buffers_;
    buffers_ += buffers_of(field, column.name);
    if (const arrow::DictionaryEncoding* dictionary = field.dictionary()) {
      column.dictionary = dictionary->id();
      column.integer = {4, true};
      if (dictionary->index()) column.integer = integer_of(*dictionary->index(), column.name);
    } else if (const arrow::Int* type = field.type_as_Int()) {
      column.integer = integer_of(*type, column.name);
    } else if (column.type == Type::Timestamp || column.type == Type::Duration) {
      column.integer = {8, true};
    }
    if (const auto* type = field.type_as_FloatingPoint()) {
      column.precision = type->precision();
      if (column.precision < arrow::Precision::MIN || column.precision > arrow::Precision::MAX)
        fail(column.name, std::to_string(int(column.precision)), "an unknown precision");
    }
    const std::string name = column.name;
    if (!out_.columns.emplace(name, std::move(column)).second)
      fail(name, "", "there are two such columns");
  }

  /// Reads the message of a block and calls `take` with it.
  template <class Take>
  void read_message(const arrow::Block& block, const char* what, const Take& take) {
    const auto offset = static_cast<std::uint64_t>(block.offset());
    const auto bytes = static_cast<std::uint64_t>(block.metadata_bytes());
    metadata_bytes_ += bytes;
    // Blocks that share their bytes would take time without end.
    if (block.offset() < 0 || block.metadata_bytes() < 8 || bytes > kMaxMetadataBytes ||
        offset > size_ || bytes > size_ - offset || metadata_bytes_ > size_)
      fail(what, "at byte " + std::to_string(block.offset()), "does not fit into the file");
    const std::string message_bytes = read_(offset, bytes);
    const std::size_t from =
        little_endian<std::uint32_t>(message_bytes, 0) == kContinuation ? 8 : 4;
    verify<arrow::Message>(message_bytes, from, what);
    take(*flatbuffers::GetRoot<arrow::Message>(message_bytes.data() + from), offset + bytes);
  }

  ArrowLayout::Batch batch_of(const arrow::RecordBatch& record, std::uint64_t body,
                              const char* what) const {
    ArrowLayout::Batch batch;
    if (record.rows() < 0 || std::uint64_t(record.rows()) > most_rows_)
      fail(what, std::to_string(record.rows()) + " rows",
           "0 to " + std::to_string(most_rows_) + " in a file of its size");
    batch.rows = static_cast<std::size_t>(record.rows());
    if (const arrow::Compression* compression = record.compression()) {
      batch.codec = compression->codec();
      if (*batch.codec != arrow::Codec::kLz4Frame && *batch.codec != arrow::Codec::kZstd)
        fail(what, "codec " + std::to_string(int(*batch.codec)), "0 (LZ4) or 1 (Zstandard)");
    }
    for_each(record.buffers(), [&](const arrow::Buffer& buffer) {
      const auto offset = static_cast<std::uint64_t>(buffer.offset()),
                 bytes = static_cast<std::uint64_t>(buffer.length());
      if (buffer.offset() < 0 || buffer.length() < 0 || offset > size_ - body ||
          bytes > size_ - body - offset)
        fail(what,
             "buffer " + std::to_string(batch.buffers.size()) + " of " +
                 std::to_string(buffer.length()) + " bytes",
             "does not fit into the file (truncated?)");
      batch.buffers.emplace_back(std::int64_t(body) + buffer.offset(), buffer.length());
    });
    return batch;
  }

  void add_batch(const arrow::Block& block) {
    read_message(block, "record batch", [&](const arrow::Message& message, std::uint64_t body) {
      const arrow::RecordBatch* record = message.header_as_RecordBatch();
      if (!record) fail("record batch", "", "is another message");
      ArrowLayout::Batch batch = batch_of(*record, body, "record batch");
      if (batch.buffers.size() < buffers_)
        fail("record batch", std::to_string(batch.buffers.size()) + " buffers",
             "the schema needs " + std::to_string(buffers_));
      out_.rows += batch.rows;
      if (out_.rows > most_rows_)
        fail("rows", std::to_string(out_.rows),
             "at most " + std::to_string(most_rows_) + " in a file of its size");
      if (batch.rows > 0) out_.batches.push_back(std::move(batch));
    });
  }

  void add_dictionary(const arrow::Block& block) {
    read_message(block, "dictionary", [&](const arrow::Message& message, std::uint64_t body) {
      const arrow::DictionaryBatch* dictionary = message.header_as_DictionaryBatch();
      if (!dictionary || !dictionary->data()) fail("dictionary", "", "is another message");
      const std::int64_t id = dictionary->id();
      if (dictionary->is_delta() ||
          !out_.dictionaries.emplace(id, batch_of(*dictionary->data(), body, "dictionary")).second)
        fail("dictionary", std::to_string(id), "in several parts, which are not read");
    });
  }

  const ReadAt& read_;
  std::uint64_t size_, most_rows_, metadata_bytes_ = 0;
  std::size_t buffers_ = 0;  // in each record batch
  ArrowLayout out_;
};

}  // namespace

ArrowLayout read_arrow_layout(const ReadAt& read, std::uint64_t file_bytes,
                              const std::filesystem::path& file) {
  return LayoutReader(read, file_bytes, file).read();
}

}  // namespace redrive
