// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/mcap.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>

#include "redrive/base/error.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/rosbag/mcap_chunks.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive::rosbag {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMagic("\x89MCAP0\r\n", 8);
constexpr std::size_t kRecordHead = 9;    // opcode, length
constexpr std::size_t kMessageHead = 22;  // channel, sequence, two times
constexpr std::size_t kFooter = 20;
constexpr std::uint64_t kMaxSummaryBytes = std::uint64_t{1} << 30;
constexpr std::uint32_t kNoChunk = 0xffffffff;  // the message stands in the file

enum Opcode : std::uint8_t {
  kFooterOp = 0x02,
  kSchemaOp = 0x03,
  kChannelOp = 0x04,
  kMessageOp = 0x05,
  kChunkOp = 0x06,
  kMessageIndexOp = 0x07,
  kChunkIndexOp = 0x08,
  kStatisticsOp = 0x0b,
  kDataEndOp = 0x0f
};

/// Takes fields from the front of a record.
class Fields {
 public:
  Fields(std::string_view bytes, const fs::path& file, const char* record)
      : bytes_(bytes), file_(file), record_(record) {}

  template <class T>
  T number() {
    return little_endian<T>(take(sizeof(T)), 0);
  }
  std::string_view text() { return take(number<std::uint32_t>()); }
  std::string_view take(std::uint64_t size) {
    if (size > bytes_.size())
      throw InputError(
          file_, record_, std::to_string(size) + " bytes",
          "is longer than its record, which has " + std::to_string(bytes_.size()) + " more");
    const std::string_view taken = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return taken;
  }
  std::string_view rest() const { return bytes_; }

 private:
  std::string_view bytes_;
  const fs::path& file_;
  const char* record_;
};

Packing packing_of(std::string_view name, const fs::path& file) {
  if (name.empty()) return Packing::kNone;
  if (name == "lz4") return Packing::kLz4;
  if (name == "zstd") return Packing::kZstd;
  throw InputError(file, "chunk.compression", name, "is lz4, zstd or empty");
}

class McapFile : public BagFile {
 public:
  McapFile(std::unique_ptr<ByteSource> bytes, const fs::path& path)
      : bytes_(std::move(bytes)), path_(path), chunks_(bytes_.get(), path) {
    const std::string head = bytes_->read(0, kMagic.size());
    if (head != kMagic)
      throw InputError(path_, "", "",
                       head.empty() ? "the file is empty" : "is no MCAP: its first bytes differ");
    if (const auto summary = summary_bytes()) {
      read_summary(*summary);
    } else {
      walk(/*has_summary=*/false);
    }
    for (auto& [id, topic] : channels_) topics_.push_back(std::move(topic));
    channels_.clear();
  }

  void read(std::span<const Message> messages, std::size_t most,
            const TakeMessage& take) const override {
    if (messages.empty()) return;
    const std::uint32_t index = messages[0].chunk;
    if (index == kNoChunk) {
      for (std::size_t i = 0; i < messages.size(); ++i)
        take(i, message_in_file(messages[i].offset, bytes_->size(), most));
      return;
    }
    const McapChunk& chunk = chunks_.at(index);
    if (chunk.packing == Packing::kNone) {
      if (most == kAllBytes) chunks_.check_crc(index);
      for (std::size_t i = 0; i < messages.size(); ++i)
        take(i, message_in_file(chunk.records + messages[i].offset, chunk.records + chunk.bytes,
                                most));
      return;
    }
    const std::shared_ptr<const std::string> records = chunks_.records(index);
    for (std::size_t i = 0; i < messages.size(); ++i)
      take(i, message_in(*records, messages[i].offset, most));
  }

 private:
  [[noreturn]] void fail(std::string_view field, std::string_view value,
                         std::string_view rule) const {
    throw InputError(path_, field, value, rule);
  }
  static std::string at(std::uint64_t offset) { return "byte " + std::to_string(offset); }

  /// Returns the records of the summary; nothing if there is none, or a damaged one.
  std::optional<std::string> summary_bytes() {
    const std::size_t tail = kRecordHead + kFooter + kMagic.size();
    const std::uint64_t size = bytes_->size();
    if (size < kMagic.size() + tail) return std::nullopt;
    const std::string end = bytes_->read(size - tail, tail);
    if (end.size() != tail || !end.ends_with(kMagic) || end[0] != kFooterOp ||
        little_endian<std::uint64_t>(end, 1) != kFooter)
      return std::nullopt;
    const auto start = little_endian<std::uint64_t>(end, kRecordHead);
    const auto crc = little_endian<std::uint32_t>(end, kRecordHead + 16);
    if (start < kMagic.size() || start >= size - tail || size - tail - start > kMaxSummaryBytes)
      return std::nullopt;
    std::string summary = bytes_->read(start, static_cast<std::size_t>(size - tail - start));
    if (crc != 0 && crc_of(summary + end.substr(0, kRecordHead + 16)) != crc) {
      findings_.push_back({path_.filename().string(), "the CRC of its summary is wrong"});
      return std::nullopt;
    }
    return summary;
  }

  /// Reads a record of a schema or a channel.
  void read_definition(std::uint8_t opcode, std::string_view content) {
    if (opcode == kSchemaOp) {
      Fields fields(content, path_, "schema");
      const auto id = fields.number<std::uint16_t>();
      Schema& schema = schemas_[id];
      schema.name = fields.text();
      schema.encoding = fields.text();
      schema.text = fields.text();
    } else if (opcode == kChannelOp) {
      Fields fields(content, path_, "channel");
      const auto id = fields.number<std::uint16_t>();
      const auto schema = fields.number<std::uint16_t>();
      Topic& topic = channels_[id];
      topic.name = fields.text();
      topic.encoding = fields.text();
      if (const auto found = schemas_.find(schema); found != schemas_.end()) {
        topic.type = found->second.name;
        topic.schema_encoding = found->second.encoding;
        topic.schema = found->second.text;
      } else if (schema != 0) {
        missing_schemas_.insert(topic.name);
      }
    }
  }

  void add_message(std::uint16_t channel, std::uint64_t log_time, std::uint64_t offset,
                   std::uint32_t chunk) {
    const auto found = channels_.find(channel);
    if (found == channels_.end()) {
      ++without_channel_;
      return;
    }
    constexpr std::uint64_t kMaxTime = std::uint64_t{1} << 62;
    found->second.messages.push_back(
        {static_cast<std::int64_t>(std::min(log_time, kMaxTime)), offset, 0, chunk});
  }

  void read_message_index(std::string_view content, std::uint32_t chunk) {
    Fields fields(content, path_, "message index");
    const auto channel = fields.number<std::uint16_t>();
    Fields entries(fields.text(), path_, "message index");
    while (!entries.rest().empty()) {
      const auto log_time = entries.number<std::uint64_t>();
      add_message(channel, log_time, entries.number<std::uint64_t>(), chunk);
    }
  }

  /// Calls `take(opcode, content, offset)` for the records of a text.
  template <class Take>
  void each_record(std::string_view bytes, const char* of, const Take& take) const {
    for (std::size_t at_byte = 0; at_byte < bytes.size();) {
      if (bytes.size() - at_byte < kRecordHead) fail(of, at(at_byte), "a record is cut off");
      const auto opcode = static_cast<std::uint8_t>(bytes[at_byte]);
      const auto length = little_endian<std::uint64_t>(bytes, at_byte + 1);
      if (length > bytes.size() - at_byte - kRecordHead)
        fail(of, std::to_string(length) + " bytes at " + at(at_byte),
             "a record is longer than what holds it");
      take(opcode, bytes.substr(at_byte + kRecordHead, length), at_byte);
      at_byte += kRecordHead + length;
    }
  }

  void read_summary(const std::string& summary) {
    struct Indexed {
      std::uint64_t start, length, index_bytes;
      McapChunk chunk;
    };
    std::vector<Indexed> indexed;
    std::uint64_t stated = 0;
    std::vector<std::string_view> channels;
    each_record(summary, "summary", [&](std::uint8_t opcode, std::string_view content, auto) {
      if (opcode == kSchemaOp) read_definition(opcode, content);
      if (opcode == kChannelOp) channels.push_back(content);
      if (opcode == kStatisticsOp)
        stated = Fields(content, path_, "statistics").number<std::uint64_t>();
      if (opcode != kChunkIndexOp) return;
      Fields fields(content, path_, "chunk index");
      fields.take(16);
      Indexed chunk{};
      chunk.start = fields.number<std::uint64_t>();
      chunk.length = fields.number<std::uint64_t>();
      fields.text();
      chunk.index_bytes = fields.number<std::uint64_t>();
      const std::string_view compression = fields.text();
      chunk.chunk.packing = packing_of(compression, path_);
      chunk.chunk.packed_bytes = fields.number<std::uint64_t>();
      chunk.chunk.bytes = fields.number<std::uint64_t>();
      constexpr std::size_t kBefore = kRecordHead + 40;  // fields before the records
      if (chunk.length < kBefore + compression.size() ||
          chunk.chunk.packed_bytes != chunk.length - kBefore - compression.size() ||
          chunk.start > bytes_->size() || chunk.length > bytes_->size() - chunk.start ||
          chunk.index_bytes > bytes_->size() - chunk.start - chunk.length)
        fail("chunk index", at(chunk.start), "its lengths do not fit the file");
      chunks_.check_size(chunk.chunk, chunk.start);
      chunk.chunk.records = chunk.start + kBefore + compression.size();
      indexed.push_back(chunk);
    });
    for (const std::string_view channel : channels) read_definition(kChannelOp, channel);
    if (indexed.empty() && stated != 0) return walk(/*has_summary=*/true);  // no chunks
    for (const Indexed& chunk : indexed) {
      const std::uint32_t index = chunks_.add(chunk.chunk);
      if (chunk.index_bytes == 0) {
        index_chunk(index, /*whole_file=*/true);
        continue;
      }
      const std::string records =
          bytes_->read(chunk.start + chunk.length, static_cast<std::size_t>(chunk.index_bytes));
      each_record(records, "message index", [&](std::uint8_t opcode, auto content, auto) {
        if (opcode == kMessageIndexOp) read_message_index(content, index);
      });
    }
    std::uint64_t found = without_channel_;
    for (const auto& [id, topic] : channels_) found += topic.messages.size();
    if (stated > found)
      findings_.push_back({path_.filename().string(), std::to_string(stated - found) + " of " +
                                                          counted(stated, "message") +
                                                          " are in no index and not read"});
    report();
  }

  /// Adds a chunk's messages from its records.
  void index_chunk(std::uint32_t index, bool whole_file) {
    const std::shared_ptr<const std::string> records = chunks_.records(index);
    each_record(*records, "chunk", [&](std::uint8_t opcode, std::string_view content, auto offset) {
      if (!whole_file) read_definition(opcode, content);
      if (opcode != kMessageOp) return;
      Fields fields(content, path_, "message");
      const auto channel = fields.number<std::uint16_t>();
      fields.take(4);
      add_message(channel, fields.number<std::uint64_t>(), offset, index);
    });
  }

  /// Walks all records of a file without indices, up to where it is cut off.
  void walk(bool has_summary) {
    const std::uint64_t size = bytes_->size();
    std::uint64_t at_byte = kMagic.size();
    std::size_t damaged = 0;
    std::string first;
    bool ended = false;
    while (at_byte < size && !ended) {
      constexpr std::size_t kFew = 256;
      const std::string head = bytes_->read(at_byte, kRecordHead + kMessageHead);
      if (head.size() < kRecordHead) break;
      const auto opcode = static_cast<std::uint8_t>(head[0]);
      const auto length = little_endian<std::uint64_t>(head, 1);
      if (length > size - at_byte - kRecordHead || opcode == 0) break;
      try {
        if (opcode == kSchemaOp || opcode == kChannelOp) {
          if (length > kMaxChunkBytes) break;
          read_definition(opcode, bytes_->read(at_byte + kRecordHead, std::size_t(length)));
        } else if (opcode == kMessageOp) {
          Fields fields(std::string_view(head).substr(
                            kRecordHead, std::min<std::uint64_t>(length, kMessageHead)),
                        path_, "message");
          const auto channel = fields.number<std::uint16_t>();
          fields.take(4);
          add_message(channel, fields.number<std::uint64_t>(), at_byte, kNoChunk);
        } else if (opcode == kChunkOp) {
          walk_chunk(bytes_->read(at_byte + kRecordHead,
                                  std::size_t(std::min<std::uint64_t>(length, kFew))),
                     at_byte + kRecordHead, length);
        }
      } catch (const InputError& error) {
        if (damaged++ == 0) first = error.what();
      }
      ended = opcode == kDataEndOp || opcode == kFooterOp;
      at_byte += kRecordHead + length;
    }
    const std::string name = path_.filename().string();
    if (!has_summary)
      findings_.push_back(
          {name, "has no summary that can be used; read by walking its records" +
                     (ended || at_byte >= size ? std::string()
                                               : ", " + counted(size - at_byte, "byte") +
                                                     " at its end are cut off and not read")});
    if (damaged > 0)
      findings_.push_back({name, counted(damaged, "record") + " left out: " + first});
    report();
  }

  void walk_chunk(std::string_view head, std::uint64_t start, std::uint64_t length) {
    Fields fields(head, path_, "chunk");
    McapChunk chunk;
    fields.take(16);
    chunk.bytes = fields.number<std::uint64_t>();
    chunk.crc = fields.number<std::uint32_t>();
    const std::string_view compression = fields.text();
    chunk.packing = packing_of(compression, path_);
    chunk.packed_bytes = fields.number<std::uint64_t>();
    chunk.records = start + 40 + compression.size();
    if (chunk.packed_bytes > length - 40 - compression.size())
      fail("chunk", at(start), "its records are longer than it");
    chunks_.check_size(chunk, start);
    index_chunk(chunks_.add(chunk), /*whole_file=*/false);
  }

  void report() {
    const std::string name = path_.filename().string();
    if (!missing_schemas_.empty())
      findings_.push_back(
          {name, "the schema is missing of " +
                     first_few(std::vector(missing_schemas_.begin(), missing_schemas_.end()))});
    if (without_channel_ > 0)
      findings_.push_back(
          {name, counted(without_channel_, "message") + " of channels that it does not list"});
  }

  /// Returns the start of a message's data. `end`: where the file or chunk that holds it ends.
  std::string message_in_file(std::uint64_t offset, std::uint64_t end, std::size_t most) const {
    std::string head = bytes_->read(
        offset, kRecordHead + kMessageHead + (most == kAllBytes ? std::size_t{0} : most));
    if (offset > end) fail("message", at(offset), "is not in the file");
    const std::size_t data = checked_data(head, offset, end - offset);
    if (most == kAllBytes) return bytes_->read(offset + kRecordHead + kMessageHead, data);
    return head.substr(kRecordHead + kMessageHead, std::min(data, most));
  }

  std::string_view message_in(std::string_view records, std::uint64_t offset,
                              std::size_t most) const {
    if (offset > records.size()) fail("message", at(offset), "is not in its chunk");
    records.remove_prefix(offset);
    const std::size_t data = checked_data(records, offset, records.size());
    return records.substr(kRecordHead + kMessageHead, std::min(data, most));
  }

  /// Returns the size of a message's data. `room`: bytes for it and its heads.
  std::size_t checked_data(std::string_view record, std::uint64_t offset,
                           std::uint64_t room) const {
    if (record.size() < kRecordHead + kMessageHead || record[0] != kMessageOp)
      fail("message", at(offset), "no message stands there");
    const auto length = little_endian<std::uint64_t>(record, 1);
    if (length < kMessageHead || length > room - kRecordHead || length > kMaxChunkBytes)
      fail("message", std::to_string(length) + " bytes at " + at(offset),
           "is longer than what holds it");
    return static_cast<std::size_t>(length - kMessageHead);
  }

  struct Schema {
    std::string name, encoding, text;
  };
  std::unique_ptr<ByteSource> bytes_;
  fs::path path_;
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, Topic> channels_;
  McapChunks chunks_;
  std::set<std::string> missing_schemas_;
  std::size_t without_channel_ = 0;
};

}  // namespace

std::unique_ptr<BagFile> open_mcap(std::unique_ptr<ByteSource> bytes, const fs::path& path) {
  return std::make_unique<McapFile>(std::move(bytes), path);
}

}  // namespace redrive::rosbag
