// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/proto_reader.h"

#include <algorithm>
#include <bit>
#include <cstring>

#include "redrive/base/error.h"

namespace redrive {
namespace {

using Wire = ProtoField::Wire;

constexpr std::size_t kBlock = 1024, kMostNumbers = std::size_t{1} << 24;

}  // namespace

std::uint8_t ProtoReader::byte() {
  if (at_ >= end_) fail("", "", "a message ends within a field");
  if (at_ < block_begin_ || at_ - block_begin_ >= block_.size()) {
    block_ = bytes_.read(at_, std::min<std::uint64_t>(kBlock, end_ - at_));
    block_begin_ = at_;
    if (block_.empty()) fail("", "", "the file ends within a message");
  }
  return static_cast<std::uint8_t>(block_[at_++ - block_begin_]);
}

std::uint64_t ProtoReader::varint() {
  std::uint64_t value = 0;
  for (int shift = 0; shift < 64; shift += 7) {
    const std::uint8_t next = byte();
    value |= std::uint64_t{next & 0x7fu} << shift;
    if (next < 0x80) return value;
  }
  fail("", "", "a number of a message is damaged");
}

std::uint64_t ProtoReader::fixed(std::size_t size) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < size; ++i) value |= std::uint64_t{byte()} << (8 * i);
  return value;
}

std::optional<ProtoField> ProtoReader::next() {
  if (at_ >= end_) return std::nullopt;
  const std::uint64_t key = varint();
  ProtoField field;
  field.number = static_cast<std::uint32_t>(key >> 3);
  switch (key & 7) {
    case 0:
      field.wire = Wire::kVarint;
      field.bits = varint();
      break;
    case 1:
      field.wire = Wire::kFixed64;
      field.bits = fixed(8);
      break;
    case 2: {
      field.wire = Wire::kBytes;
      const std::uint64_t size = varint();
      if (size > end_ - at_) fail("", std::to_string(size) + " bytes", "reach beyond a message");
      field.span = {at_, at_ + size};
      at_ += size;
      break;
    }
    case 5:
      field.wire = Wire::kFixed32;
      field.bits = fixed(4);
      break;
    default: fail("", "", "a field of a message is damaged");
  }
  return field;
}

void ProtoReader::require(const ProtoField& field, Wire wire, const char* name) const {
  if (field.wire != wire) fail(name, "", "is of another kind");
}

std::int64_t ProtoReader::integer(const ProtoField& field, const char* name) const {
  require(field, Wire::kVarint, name);
  return static_cast<std::int64_t>(field.bits);
}

double ProtoReader::number(const ProtoField& field, const char* name) const {
  require(field, Wire::kFixed64, name);
  return std::bit_cast<double>(field.bits);
}

std::string ProtoReader::text(const ProtoField& field, const char* name, std::size_t most) const {
  require(field, Wire::kBytes, name);
  if (field.span.size() > most)
    fail(name, std::to_string(field.span.size()) + " bytes",
         "must be at most " + std::to_string(most));
  std::string text = bytes_.read(field.span.begin, field.span.size());
  if (text.size() != field.span.size()) fail(name, "", "the file ends within it");
  return text;
}

ProtoReader ProtoReader::message(const ProtoField& field, const char* name) const {
  require(field, Wire::kBytes, name);
  return {bytes_, field.span, file_};
}

void ProtoReader::append(const ProtoField& field, const char* name,
                         std::vector<std::int64_t>* to) const {
  constexpr std::size_t kMostIntegers = std::size_t{1} << 16;
  if (field.wire == Wire::kVarint) to->push_back(integer(field, name));
  if (field.wire != Wire::kVarint) {
    ProtoReader packed = message(field, name);
    while (packed.at_ < packed.end_ && to->size() <= kMostIntegers)
      to->push_back(static_cast<std::int64_t>(packed.varint()));
  }
  if (to->size() > kMostIntegers) fail(name, "", "must be at most 2^16 integers");
}

void ProtoReader::append(const ProtoField& field, const char* name, std::vector<double>* to) const {
  if (field.wire == Wire::kFixed64)
    to->push_back(std::bit_cast<double>(field.bits));
  else
    append_packed(text(field, name, kMostNumbers * sizeof(double)), name, to);
}

void ProtoReader::append(const ProtoField& field, const char* name, std::vector<float>* to) const {
  if (field.wire == Wire::kFixed32)
    to->push_back(std::bit_cast<float>(static_cast<std::uint32_t>(field.bits)));
  else
    append_packed(text(field, name, kMostNumbers * sizeof(float)), name, to);
}

template <class T>
void ProtoReader::append_packed(const std::string& packed, const char* name,
                                std::vector<T>* to) const {
  const std::size_t had = to->size(), more = packed.size() / sizeof(T);
  if (packed.size() % sizeof(T) != 0 || had + more > kMostNumbers)
    fail(name, std::to_string(packed.size()) + " bytes",
         "must be whole numbers, at most 2^24 of them");
  to->resize(had + more);
  std::memcpy(to->data() + had, packed.data(), packed.size());
}

void ProtoReader::fail(const std::string& name, const std::string& value,
                       const std::string& rule) const {
  throw InputError(file_, name, value, rule);
}

}  // namespace redrive
