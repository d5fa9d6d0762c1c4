// SPDX-License-Identifier: Apache-2.0
// Writes MCAP files and CDR messages for tests.
#pragma once

#include <algorithm>
#include <bit>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#include <lz4frame.h>
#include <zlib.h>
#include <zstd.h>

#include "redrive/recording/parse/little_endian.h"

namespace redrive::testing {

/// Serialises as DDS does: a value is aligned to its size, after the four first bytes.
class CdrWriter {
 public:
  explicit CdrWriter(bool big_endian = false)
      : big_endian_(big_endian), bytes_({'\0', big_endian ? '\0' : '\1', '\0', '\0'}) {}

  template <class T>
  CdrWriter& add(T value) {
    while ((bytes_.size() - 4) % sizeof(T) != 0) bytes_ += '\0';
    char raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof(T));
    if (big_endian_) std::reverse(raw, raw + sizeof(T));
    bytes_.append(raw, sizeof(T));
    return *this;
  }
  CdrWriter& text(const std::string& value) {
    add<std::uint32_t>(static_cast<std::uint32_t>(value.size() + 1));
    bytes_ += value + '\0';
    return *this;
  }
  CdrWriter& blob(const std::string& value) {
    add<std::uint32_t>(static_cast<std::uint32_t>(value.size()));
    bytes_ += value;
    return *this;
  }
  CdrWriter& header(std::int64_t t_ns, const std::string& frame) {
    return add<std::int32_t>(static_cast<std::int32_t>(t_ns / 1'000'000'000))
        .add<std::uint32_t>(static_cast<std::uint32_t>(t_ns % 1'000'000'000))
        .text(frame);
  }
  CdrWriter& doubles(const std::vector<double>& values) {
    for (const double x : values) add(x);
    return *this;
  }
  const std::string& bytes() const { return bytes_; }

 private:
  bool big_endian_;
  std::string bytes_;
};

struct McapOptions {
  std::string compression = "lz4";  ///< "", "lz4", "zstd"
  std::size_t chunk_bytes = 4096;   ///< 0: messages without chunks
  bool summary = true, message_index = true;
  bool crc = true;
};

class McapWriter {
 public:
  using Options = McapOptions;
  explicit McapWriter(Options options = {}) : options_(options) {
    bytes_ = magic();
    record(0x01, text("ros2") + text("redrive test"), &bytes_);
  }

  std::uint16_t channel(const std::string& topic, const std::string& type,
                        const std::string& schema, const std::string& encoding = "cdr") {
    const auto id = static_cast<std::uint16_t>(channels_.size() + 1);
    std::string definition, channel;
    add_bytes<std::uint16_t>(id, &definition);
    definition += text(type) + text("ros2msg") + text(schema);
    add_bytes<std::uint16_t>(id, &channel);
    add_bytes<std::uint16_t>(id, &channel);
    channel += text(topic) + text(encoding) + text("");
    std::string both;
    if (!schema.empty() || type.empty()) record(0x03, definition, &both);
    record(0x04, channel, &both);
    channels_.push_back(both);
    (options_.chunk_bytes == 0 ? bytes_ : chunk_) += both;
    return id;
  }
  void message(std::uint16_t channel, std::int64_t log_ns, const std::string& data) {
    std::string content;
    add_bytes<std::uint16_t>(channel, &content);
    add_bytes<std::uint32_t>(0, &content);
    add_bytes<std::uint64_t>(static_cast<std::uint64_t>(log_ns), &content);
    add_bytes<std::uint64_t>(static_cast<std::uint64_t>(log_ns), &content);
    content += data;
    ++messages_;
    if (options_.chunk_bytes == 0) return record(0x05, content, &bytes_);
    std::string& index = index_[channel];
    add_bytes<std::uint64_t>(static_cast<std::uint64_t>(log_ns), &index);
    add_bytes<std::uint64_t>(chunk_.size(), &index);
    record(0x05, content, &chunk_);
    if (chunk_.size() >= options_.chunk_bytes) end_chunk();
  }
  /// Returns the file; with `summary` false it ends as a recorder's that crashed.
  std::string finish() {
    end_chunk();
    if (!options_.summary) return bytes_;
    record(0x0f, std::string(4, '\0'), &bytes_);
    const std::uint64_t start = bytes_.size();
    for (const std::string& channel : channels_) bytes_ += channel;
    std::string statistics;
    add_bytes<std::uint64_t>(messages_, &statistics);
    statistics += std::string(34, '\0') + std::string(4, '\0');
    record(0x0b, statistics, &bytes_);
    bytes_ += chunk_indices_;
    std::string footer;
    add_bytes<std::uint64_t>(start, &footer);
    add_bytes<std::uint64_t>(0, &footer);
    std::string until_crc = bytes_.substr(start);
    until_crc += '\x02';
    add_bytes<std::uint64_t>(20, &until_crc);
    until_crc += footer;
    add_bytes<std::uint32_t>(options_.crc ? crc(until_crc) : 0, &footer);
    record(0x02, footer, &bytes_);
    return bytes_ + magic();
  }

  static std::string magic() { return std::string("\x89MCAP0\r\n", 8); }
  static std::string text(const std::string& value) {
    std::string out;
    add_bytes<std::uint32_t>(static_cast<std::uint32_t>(value.size()), &out);
    return out + value;
  }
  static void record(std::uint8_t opcode, const std::string& content, std::string* out) {
    *out += static_cast<char>(opcode);
    add_bytes<std::uint64_t>(content.size(), out);
    *out += content;
  }
  static std::uint32_t crc(const std::string& bytes) {
    return static_cast<std::uint32_t>(
        ::crc32(0, reinterpret_cast<const Bytef*>(bytes.data()), static_cast<uInt>(bytes.size())));
  }

 private:
  std::string packed() const {
    std::string out;
    if (options_.compression == "lz4") {
      out.resize(LZ4F_compressFrameBound(chunk_.size(), nullptr));
      out.resize(LZ4F_compressFrame(out.data(), out.size(), chunk_.data(), chunk_.size(), nullptr));
    } else if (options_.compression == "zstd") {
      out.resize(ZSTD_compressBound(chunk_.size()));
      out.resize(ZSTD_compress(out.data(), out.size(), chunk_.data(), chunk_.size(), 1));
    } else {
      out = chunk_;
    }
    return out;
  }
  void end_chunk() {
    if (chunk_.empty()) return;
    const std::string records = packed();
    std::string chunk(16, '\0');
    add_bytes<std::uint64_t>(chunk_.size(), &chunk);
    add_bytes<std::uint32_t>(options_.crc ? crc(chunk_) : 0, &chunk);
    chunk += text(options_.compression);
    add_bytes<std::uint64_t>(records.size(), &chunk);
    chunk += records;
    const std::uint64_t start = bytes_.size();
    record(0x06, chunk, &bytes_);
    const std::uint64_t end = bytes_.size();
    for (const auto& [channel, entries] : index_) {
      std::string index;
      add_bytes<std::uint16_t>(channel, &index);
      if (options_.message_index) record(0x07, index + text(entries), &bytes_);
    }
    std::string of(16, '\0');
    add_bytes<std::uint64_t>(start, &of);
    add_bytes<std::uint64_t>(end - start, &of);
    of += text("");
    add_bytes<std::uint64_t>(bytes_.size() - end, &of);
    of += text(options_.compression);
    add_bytes<std::uint64_t>(records.size(), &of);
    add_bytes<std::uint64_t>(chunk_.size(), &of);
    record(0x08, of, &chunk_indices_);
    chunk_.clear();
    index_.clear();
  }

  Options options_;
  std::string bytes_, chunk_, chunk_indices_;
  std::vector<std::string> channels_;
  std::map<std::uint16_t, std::string> index_;
  std::uint64_t messages_ = 0;
};

}  // namespace redrive::testing
