// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/indexed_tar.h"

#include <algorithm>
#include <cstdio>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/base/files/xz.h"
#include "redrive/base/json_field.h"

namespace redrive {
namespace {

constexpr std::size_t kTarBlock = 512, kMostTarName = 100, kMostTarPrefix = 155;
constexpr std::uint64_t kMostTarBytes = std::uint64_t{1} << 33;
constexpr std::size_t kMostIndexBytes = std::size_t{1} << 28;

void put(std::string_view text, std::size_t at, std::string* block) {
  std::ranges::copy(text, block->begin() + static_cast<std::ptrdiff_t>(at));
}

/// Returns the header of a file without owner and time; nothing where its name does not fit.
std::string tar_header(const std::string& name, std::uint64_t size) {
  std::string_view last = name, prefix;
  if (name.size() > kMostTarName) {
    const std::size_t slash = name.find('/', name.size() - kMostTarName - 1);
    if (slash == name.npos || slash > kMostTarPrefix) return {};
    prefix = last.substr(0, slash);
    last = last.substr(slash + 1);
  }
  std::string block(kTarBlock, '\0');
  char size_text[13];
  std::snprintf(size_text, sizeof size_text, "%011llo", static_cast<unsigned long long>(size));
  put(last, 0, &block);
  put("0000644", 100, &block);
  put("0000000", 108, &block);
  put("0000000", 116, &block);
  put(size_text, 124, &block);
  put("00000000000", 136, &block);
  put("        ", 148, &block);  // the checksum counts as blanks
  put("0", 156, &block);
  put("ustar", 257, &block);
  put("00", 263, &block);
  put(prefix, 345, &block);
  unsigned sum = 0;
  for (const char c : block) sum += static_cast<unsigned char>(c);
  char sum_text[8];
  std::snprintf(sum_text, sizeof sum_text, "%06o", sum);
  put({sum_text, 7}, 148, &block);
  return block;
}

std::string little_endian(std::uint64_t value, std::size_t bytes) {
  std::string text;
  for (std::size_t i = 0; i < bytes; ++i) text += static_cast<char>(value >> (8 * i) & 0xff);
  return text;
}

}  // namespace

IndexedTarWriter::IndexedTarWriter(const std::filesystem::path& path) : path_(path), file_(path) {}

void IndexedTarWriter::write(std::string_view bytes) {
  file_.write(bytes);
  written_ += bytes.size();
}

void IndexedTarWriter::fill_block() {
  const std::size_t past = written_ % kTarBlock;
  if (past > 0) write(std::string(kTarBlock - past, '\0'));
}

void IndexedTarWriter::add(const std::string& name, std::string_view bytes) {
  if (bytes.size() >= kMostTarBytes) throw IoError(path_, name + ": is too large for a tar");
  const std::string header = tar_header(name, bytes.size());
  if (header.empty()) throw IoError(path_, name + ": is too long a name for a tar");
  write(header);
  items_.push_back(name);
  offsets_.push_back(written_);
  sizes_.push_back(bytes.size());
  write(bytes);
  fill_block();
}

void IndexedTarWriter::finish() {
  write(std::string(2 * kTarBlock, '\0'));
  const std::uint64_t offset = written_;
  const std::vector<std::uint8_t> cbor =
      nlohmann::json::to_cbor({{"items", items_}, {"offset_datas", offsets_}, {"sizes", sizes_}});
  const std::string index = xz({reinterpret_cast<const char*>(cbor.data()), cbor.size()});
  write(index);
  fill_block();
  write("itar" + little_endian(1, 4) + little_endian(offset, 8) + little_endian(index.size(), 4));
  fill_block();
  file_.finish();
}

IndexedTar::IndexedTar(std::unique_ptr<const ByteSource> bytes, std::filesystem::path path)
    : bytes_(std::move(bytes)), path_(std::move(path)) {
  const std::uint64_t size = bytes_->size();
  const std::string end =
      size < kTarBlock ? std::string() : bytes_->read(size - kTarBlock, kTarBlock);
  if (!end.starts_with("itar")) fail("", "", "does not end with an index: it may have been cut");
  const auto number = [&](std::size_t at, std::size_t count) {
    std::uint64_t value = 0;
    for (std::size_t i = 0; i < count; ++i)
      value |= std::uint64_t{static_cast<unsigned char>(end[at + i])} << (8 * i);
    return value;
  };
  const std::uint64_t version = number(4, 4), offset = number(8, 8), packed = number(16, 4);
  if (version != 1) fail("version of the index", std::to_string(version), "must be 1");
  if (offset > size - kTarBlock || packed > size - kTarBlock - offset)
    fail("index", std::to_string(packed) + " bytes at " + std::to_string(offset),
         "lies beyond the end of the file");
  const auto index = unxz_at_most(kMostIndexBytes, bytes_->read(offset, packed));
  const nlohmann::json all =
      index ? nlohmann::json::from_cbor(*index, /*strict=*/true, /*allow_exceptions=*/false)
            : nlohmann::json(nlohmann::json::value_t::discarded);
  if (all.is_discarded()) fail("index", "", "is damaged");
  const JsonField root(all, path_);
  const JsonField items = root.at("items"), offsets = root.at("offset_datas"),
                  sizes = root.at("sizes");
  if (!items.json().is_array() || offsets.size() != items.size() || sizes.size() != items.size())
    fail("index", "", "must have as many names as places and sizes");
  for (std::size_t i = 0; i < items.size(); ++i) {
    const std::int64_t at = offsets.at(i).integer(), bytes_of = sizes.at(i).integer();
    if (at < 0 || bytes_of < 0 || std::uint64_t(at) > offset ||
        std::uint64_t(bytes_of) > offset - std::uint64_t(at))
      fail("sizes[" + std::to_string(i) + "]", std::to_string(bytes_of), "lies beyond the index");
    members_[items.at(i).string()] = {std::uint64_t(at), std::uint64_t(bytes_of)};
  }
}

std::string IndexedTar::read(const Member& member, std::size_t most) const {
  const std::size_t wanted = std::min<std::uint64_t>(member.size, most);
  std::string bytes = bytes_->read(member.offset, wanted);
  if (bytes.size() != wanted) fail("", "", "ends within a member");
  return bytes;
}

void IndexedTar::fail(const std::string& field, const std::string& value,
                      const std::string& rule) const {
  throw InputError(path_, field, value, rule);
}

}  // namespace redrive
