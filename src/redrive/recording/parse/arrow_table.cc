// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/arrow_table.h"

#include <lz4frame.h>
#include <zstd.h>

#include <Eigen/Core>
#include <fstream>
#include <limits>

#include "redrive/base/error.h"
#include "redrive/recording/parse/arrow_layout.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using arrow::Type;
using Column = ArrowLayout::Column;
using Batch = ArrowLayout::Batch;

constexpr std::size_t kMaxTextBytesOfColumn = std::size_t{1} << 28;

/// Unpacks a frame of LZ4. False unless it gives exactly the bytes of `out`.
bool unpack_lz4(std::string_view packed, std::string* out) {
  LZ4F_dctx* context = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION))) return false;
  const std::unique_ptr<LZ4F_dctx, decltype(&LZ4F_freeDecompressionContext)> owner(
      context, &LZ4F_freeDecompressionContext);
  std::size_t read = 0, written = 0, wanted = 1;
  while (wanted != 0) {
    std::size_t in = packed.size() - read, made = out->size() - written;
    wanted =
        LZ4F_decompress(context, out->data() + written, &made, packed.data() + read, &in, nullptr);
    if (LZ4F_isError(wanted) || (in == 0 && made == 0)) return false;
    read += in;
    written += made;
  }
  return written == out->size();
}

bool unpack_zstd(std::string_view packed, std::string* out) {
  return ZSTD_decompress(out->data(), out->size(), packed.data(), packed.size()) == out->size();
}

std::int64_t integer_at(std::string_view bytes, const ArrowLayout::Integer& type, std::size_t i) {
  const auto as = [&]<class Signed, class Unsigned>(Signed, Unsigned) {
    return type.is_signed
               ? static_cast<std::int64_t>(little_endian<Signed>(bytes, sizeof(Signed) * i))
               : static_cast<std::int64_t>(little_endian<Unsigned>(bytes, sizeof(Unsigned) * i));
  };
  switch (type.bytes) {
    case 1: return as(std::int8_t{}, std::uint8_t{});
    case 2: return as(std::int16_t{}, std::uint16_t{});
    case 4: return as(std::int32_t{}, std::uint32_t{});
    default: return little_endian<std::int64_t>(bytes, 8 * i);
  }
}

double float_at(std::string_view bytes, arrow::Precision precision, std::size_t i) {
  switch (precision) {
    case arrow::Precision::kHalf:
      return double{Eigen::half_impl::half_to_float(
          Eigen::half_impl::raw_uint16_to_half(little_endian<std::uint16_t>(bytes, 2 * i)))};
    case arrow::Precision::kSingle: return double{little_endian<float>(bytes, 4 * i)};
    default: return little_endian<double>(bytes, 8 * i);
  }
}

bool bit_at(std::string_view bytes, std::size_t i) {
  return (static_cast<unsigned char>(bytes[i / 8]) >> (i % 8) & 1) != 0;
}

/// Decodes a column, batch by batch.
class ColumnReader {
 public:
  ColumnReader(std::string_view bytes, const ArrowLayout& layout, const std::string& name)
      : bytes_(bytes), layout_(layout), column_(find(layout, name)) {}

  std::vector<double> numbers() const {
    std::vector<double> out;
    out.reserve(layout_.rows);
    const auto add = [&](const Batch& batch, std::size_t bytes, const auto& value) {
      const std::string values = unpack(batch, column_.first_buffer + 1, bytes);
      const std::string valid = validity(batch);
      for (std::size_t i = 0; i < batch.rows; ++i)
        out.push_back(valid.empty() || bit_at(valid, i) ? value(values, i)
                                                        : std::numeric_limits<double>::quiet_NaN());
    };
    for (const Batch& batch : layout_.batches) {
      if (column_.dictionary) refuse("numbers");
      if (column_.type == Type::FloatingPoint) {
        add(batch, batch.rows * (std::size_t{2} << int(column_.precision)),
            [&](std::string_view values, std::size_t i) {
              return float_at(values, column_.precision, i);
            });
      } else if (column_.type == Type::Bool) {
        add(batch, (batch.rows + 7) / 8,
            [](std::string_view values, std::size_t i) { return bit_at(values, i) ? 1.0 : 0.0; });
      } else if (column_.integer.bytes > 0) {
        add(batch, batch.rows * column_.integer.bytes, [&](std::string_view values, std::size_t i) {
          const std::int64_t value = integer_at(values, column_.integer, i);
          return column_.integer.is_signed ? static_cast<double>(value)
                                           : static_cast<double>(static_cast<std::uint64_t>(value));
        });
      } else {
        refuse("numbers");
      }
    }
    return out;
  }

  std::vector<std::int64_t> integers() const {
    std::vector<std::int64_t> out;
    out.reserve(layout_.rows);
    for (const Batch& batch : layout_.batches) {
      if (column_.dictionary || (column_.type != Type::Bool && column_.integer.bytes == 0))
        refuse("integers");
      const std::vector<std::optional<std::int64_t>> values = integers_of(batch);
      for (const std::optional<std::int64_t>& value : values) {
        if (!value) fail("row " + std::to_string(out.size()), "has no value");
        out.push_back(*value);
      }
    }
    return out;
  }

  std::vector<std::string> texts() const {
    if (column_.type != Type::Utf8 && column_.type != Type::LargeUtf8) refuse("texts");
    std::vector<std::string> out;
    out.reserve(layout_.rows);
    std::size_t bytes = 0;
    const auto add = [&](const std::string& text) {
      if ((bytes += text.size()) > kMaxTextBytesOfColumn) fail("", "has more than 256 MB of text");
      out.push_back(text);
    };
    if (!column_.dictionary) {
      for (const Batch& batch : layout_.batches)
        for (const std::string& text : texts_of(batch, column_.first_buffer)) add(text);
      return out;
    }
    const auto dictionary = layout_.dictionaries.find(*column_.dictionary);
    if (dictionary == layout_.dictionaries.end()) fail("", "has no dictionary");
    if (dictionary->second.buffers.size() < 3) fail("", "has a dictionary of other values");
    const std::vector<std::string> words = texts_of(dictionary->second, 0);
    for (const Batch& batch : layout_.batches)
      for (const std::optional<std::int64_t>& index : integers_of(batch)) {
        if (index && (*index < 0 || *index >= std::ssize(words)))
          fail("index " + std::to_string(*index), "the dictionary has no such text");
        add(index ? words[static_cast<std::size_t>(*index)] : "");
      }
    return out;
  }

 private:
  static const Column& find(const ArrowLayout& layout, const std::string& name) {
    const auto found = layout.columns.find(name);
    if (found == layout.columns.end())
      throw InputError(layout.file, name, "", "there is no such column");
    return found->second;
  }
  [[noreturn]] void fail(const std::string& value, const std::string& rule) const {
    throw InputError(layout_.file, column_.name, value, rule);
  }
  [[noreturn]] void refuse(const char* wanted) const {
    fail(
        std::string(column_.dictionary ? "dictionary of " : "") + arrow::EnumNameType(column_.type),
        std::string("the column must hold ") + wanted);
  }

  /// Returns a buffer of at least `need` bytes.
  std::string unpack(const Batch& batch, std::size_t index, std::size_t need) const {
    const arrow::Buffer& buffer = batch.buffers[index];
    std::string_view raw = bytes_.substr(static_cast<std::size_t>(buffer.offset()),
                                         static_cast<std::size_t>(buffer.length()));
    const auto too_short = [&](std::uint64_t size) {
      fail(std::to_string(size) + " bytes", "its rows need " + std::to_string(need));
    };
    if (batch.codec && !raw.empty()) {
      if (raw.size() < 8) too_short(0);
      const auto size = little_endian<std::int64_t>(raw, 0);
      raw.remove_prefix(8);
      if (size != -1) {
        if (size < 0 || std::uint64_t(size) < need) too_short(std::uint64_t(size));
        if (std::uint64_t(size) > 2 * need + 1024)  // writers pad, nobody doubles
          fail(std::to_string(size) + " bytes", "its rows need only " + std::to_string(need));
        std::string out(static_cast<std::size_t>(size), '\0');
        if (!(batch.codec == arrow::Codec::kLz4Frame ? unpack_lz4(raw, &out)
                                                     : unpack_zstd(raw, &out)))
          fail("", std::string("has damaged ") +
                       (batch.codec == arrow::Codec::kLz4Frame ? "LZ4" : "Zstandard"));
        return out;
      }
    }
    if (raw.size() < need) too_short(raw.size());
    return std::string(raw.substr(0, need));
  }

  /// Bits that say which rows have a value; empty: all.
  std::string validity(const Batch& batch, std::size_t index) const {
    return batch.buffers[index].length() == 0 ? "" : unpack(batch, index, (batch.rows + 7) / 8);
  }
  std::string validity(const Batch& batch) const { return validity(batch, column_.first_buffer); }

  std::vector<std::optional<std::int64_t>> integers_of(const Batch& batch) const {
    const std::string valid = validity(batch);
    const bool bits = column_.type == Type::Bool;
    const std::string values =
        unpack(batch, column_.first_buffer + 1,
               bits ? (batch.rows + 7) / 8 : batch.rows * column_.integer.bytes);
    std::vector<std::optional<std::int64_t>> out(batch.rows);
    for (std::size_t i = 0; i < batch.rows; ++i) {
      if (!valid.empty() && !bit_at(valid, i)) continue;
      out[i] = bits ? std::int64_t{bit_at(values, i)} : integer_at(values, column_.integer, i);
      if (*out[i] < 0 && !bits && !column_.integer.is_signed)
        fail(std::to_string(static_cast<std::uint64_t>(*out[i])), "at most 9223372036854775807");
    }
    return out;
  }

  std::vector<std::string> texts_of(const Batch& batch, std::size_t first_buffer) const {
    if (batch.rows == 0) return {};
    const ArrowLayout::Integer type = {column_.type == Type::Utf8 ? std::size_t{4} : 8, true};
    const std::string valid = validity(batch, first_buffer),
                      offsets = unpack(batch, first_buffer + 1, (batch.rows + 1) * type.bytes);
    const std::int64_t end = integer_at(offsets, type, batch.rows);
    if (end < 0 || std::uint64_t(end) > kMaxTextBytesOfColumn)
      fail(std::to_string(end) + " bytes", "texts have 0 to 256 MB");
    const std::string all = unpack(batch, first_buffer + 2, static_cast<std::size_t>(end));
    std::vector<std::string> out(batch.rows);
    for (std::size_t i = 0; i < batch.rows; ++i) {
      const std::int64_t from = integer_at(offsets, type, i), to = integer_at(offsets, type, i + 1);
      if (from < 0 || from > to || to > end)
        fail("row " + std::to_string(i) + " from byte " + std::to_string(from) + " to " +
                 std::to_string(to),
             "its texts have " + std::to_string(end));
      if (valid.empty() || bit_at(valid, i))
        out[i] = all.substr(std::size_t(from), std::size_t(to - from));
    }
    return out;
  }

  std::string_view bytes_;
  const ArrowLayout& layout_;
  const Column& column_;
};

}  // namespace

ArrowTable::ArrowTable(std::string_view bytes, const std::filesystem::path& file)
    : bytes_(bytes),
      layout_(std::make_unique<ArrowLayout>(read_arrow_layout(
          [&](std::uint64_t offset, std::uint64_t size) {
            return std::string(bytes.substr(offset, size));
          },
          bytes.size(), file))) {}
ArrowTable::~ArrowTable() = default;

std::size_t ArrowTable::rows() const { return layout_->rows; }
bool ArrowTable::has(const std::string& column) const { return layout_->columns.contains(column); }

std::vector<double> ArrowTable::numbers(const std::string& column) const {
  return ColumnReader(bytes_, *layout_, column).numbers();
}
std::vector<std::int64_t> ArrowTable::integers(const std::string& column) const {
  return ColumnReader(bytes_, *layout_, column).integers();
}
std::vector<std::string> ArrowTable::texts(const std::string& column) const {
  return ColumnReader(bytes_, *layout_, column).texts();
}

std::uint64_t arrow_rows(const std::filesystem::path& file) {
  std::error_code error;
  const std::uintmax_t size = std::filesystem::file_size(file, error);
  std::ifstream stream(file, std::ios::binary);
  if (error || !stream) return 0;
  const auto read = [&](std::uint64_t offset, std::uint64_t bytes) {
    std::string out(bytes, '\0');
    stream.seekg(static_cast<std::streamoff>(offset));
    stream.read(out.data(), static_cast<std::streamsize>(bytes));
    return out;
  };
  try {
    return read_arrow_layout(read, size, file).rows;
  } catch (const InputError&) {
    return 0;
  }
}

}  // namespace redrive
