// SPDX-License-Identifier: Apache-2.0
// Messages of Protocol Buffers, field by field, in a file of which large fields are skipped: the
// wire format of protobuf.dev/programming-guides/encoding.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "redrive/base/files/byte_source.h"

namespace redrive {

/// A part of a file.
struct ByteSpan {
  std::uint64_t begin = 0, end = 0;
  std::uint64_t size() const { return end - begin; }
};

/// A field as the wire has it.
struct ProtoField {
  enum class Wire { kVarint, kFixed64, kBytes, kFixed32 };
  std::uint32_t number = 0;
  Wire wire = Wire::kVarint;
  std::uint64_t bits = 0;  ///< a number's
  ByteSpan span = {};      ///< place of a text, a message or packed numbers
};

/// Reads a message. Source and path must outlive it.
class ProtoReader {
 public:
  ProtoReader(const ByteSource& bytes, ByteSpan message, const std::filesystem::path& file)
      : bytes_(bytes), file_(file), at_(message.begin), end_(message.end) {}

  /// Returns the next field, nothing at the end. InputError for a damaged message.
  std::optional<ProtoField> next();

  // What a field has. `name` is for messages. InputError for a field of another kind.
  std::int64_t integer(const ProtoField& field, const char* name) const;
  double number(const ProtoField& field, const char* name) const;  ///< a double
  std::string text(const ProtoField& field, const char* name, std::size_t most = 1 << 16) const;
  /// The fields of a message within the message.
  ProtoReader message(const ProtoField& field, const char* name) const;
  /// Appends integers (up to 2^16), doubles or floats (2^24), packed or one by one.
  void append(const ProtoField& field, const char* name, std::vector<std::int64_t>* to) const;
  void append(const ProtoField& field, const char* name, std::vector<double>* to) const;
  void append(const ProtoField& field, const char* name, std::vector<float>* to) const;

  [[noreturn]] void fail(const std::string& name, const std::string& value,
                         const std::string& rule) const;

 private:
  std::uint64_t varint();
  std::uint64_t fixed(std::size_t size);
  std::uint8_t byte();
  template <class T>
  void append_packed(const std::string& packed, const char* name, std::vector<T>* to) const;
  void require(const ProtoField& field, ProtoField::Wire wire, const char* name) const;

  const ByteSource& bytes_;
  const std::filesystem::path& file_;
  std::uint64_t at_, end_;
  std::string block_;  ///< bytes from block_begin_ on
  std::uint64_t block_begin_ = 0;
};

}  // namespace redrive
