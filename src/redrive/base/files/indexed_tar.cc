// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/indexed_tar.h"

#include <algorithm>
#include <cstdio>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/base/files/xz.h"

namespace redrive {
namespace {

constexpr std::size_t kTarBlock = 512, kMostTarName = 100, kMostTarPrefix = 155;
constexpr std::uint64_t kMostTarBytes = std::uint64_t{1} << 33;
constexpr std::size_t kMostIndexBytes = std::size_t{1} << 27;

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

/// Takes {"items": [text], "offset_datas": [number], "sizes": [number]} and refuses all else,
/// before it takes memory or nests.
struct IndexParser : nlohmann::json_sax<nlohmann::json> {
  std::vector<std::string> items;
  std::vector<std::uint64_t> offsets, sizes;

  bool start_object(std::size_t) override { return ++depth_ == 1; }
  bool end_object() override { return --depth_ == 0; }
  bool start_array(std::size_t) override { return ++depth_ == 2; }
  bool end_array() override { return --depth_ == 1; }
  bool key(std::string& name) override {
    key_ = name;
    return true;
  }
  bool string(std::string& text) override {
    if (depth_ != 2 || key_ != "items" || items.size() >= kMostMembers) return false;
    items.push_back(text);
    return true;
  }
  bool number_unsigned(std::uint64_t number) override {
    std::vector<std::uint64_t>& to = key_ == "sizes" ? sizes : offsets;
    if (depth_ != 2 || (key_ != "sizes" && key_ != "offset_datas") || to.size() >= kMostMembers)
      return false;
    to.push_back(number);
    return true;
  }
  bool null() override { return false; }
  bool boolean(bool) override { return false; }
  bool number_integer(std::int64_t) override { return false; }
  bool number_float(double, const std::string&) override { return false; }
  bool binary(nlohmann::json::binary_t&) override { return false; }
  bool parse_error(std::size_t, const std::string&, const nlohmann::json::exception&) override {
    return false;
  }

 private:
  static constexpr std::size_t kMostMembers = std::size_t{1} << 22;
  int depth_ = 0;
  std::string key_;
};

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
  IndexParser parsed;
  if (!index || !nlohmann::json::sax_parse(*index, &parsed, nlohmann::json::input_format_t::cbor))
    fail("index", "", "is damaged");
  if (parsed.offsets.size() != parsed.items.size() || parsed.sizes.size() != parsed.items.size())
    fail("index", "", "must have as many names as places and sizes");
  for (std::size_t i = 0; i < parsed.items.size(); ++i) {
    const std::uint64_t at = parsed.offsets[i], bytes_of = parsed.sizes[i];
    if (at > offset || bytes_of > offset - at)
      fail("sizes[" + std::to_string(i) + "]", std::to_string(bytes_of), "lies beyond the index");
    members_[parsed.items[i]] = {at, bytes_of};
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
