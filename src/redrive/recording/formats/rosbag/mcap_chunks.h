// SPDX-License-Identifier: Apache-2.0
// Chunks of a file in MCAP: records behind each other, which may be LZ4 or Zstandard.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "redrive/base/files/byte_source.h"
#include "redrive/recording/formats/rosbag/unpack.h"

namespace redrive::rosbag {

constexpr std::uint64_t kMaxChunkBytes = std::uint64_t{1} << 30;

/// A chunk by its place.
struct McapChunk {
  std::uint64_t records = 0;  ///< offset of its records in the file
  std::uint64_t packed_bytes = 0, bytes = 0;
  std::uint32_t crc = 0;  ///< CRC of the records; 0: not known
  Packing packing = Packing::kNone;
};

/// Returns the CRC of bytes behind others, of which `before` is the CRC.
std::uint32_t crc_of(std::string_view bytes, std::uint32_t before = 0);

/// Usable from any thread once all chunks are added. Damage is an InputError, which names `path`.
class McapChunks {
 public:
  McapChunks(const ByteSource* bytes, std::filesystem::path path)
      : bytes_(*bytes), path_(std::move(path)) {}

  /// Returns the chunk's index.
  std::uint32_t add(const McapChunk& chunk);
  const McapChunk& at(std::uint32_t index) const { return chunks_[index]; }
  /// InputError for sizes that no chunk has. `start`: offset that the error names.
  void check_size(const McapChunk& chunk, std::uint64_t start) const;
  /// Returns a chunk's records, unpacked, with the right CRC. The last few stay in memory.
  std::shared_ptr<const std::string> records(std::uint32_t index) const;
  /// Checks the CRC of a chunk without compression. It is computed once.
  void check_crc(std::uint32_t index) const;

 private:
  [[noreturn]] void fail(std::uint64_t offset, std::string_view rule) const;
  std::string unpack(const McapChunk& chunk) const;
  void check_crc(std::uint32_t index, const std::function<std::uint32_t()>& computed) const;
  std::uint32_t crc_in_file(const McapChunk& chunk) const;
  std::uint32_t stated_crc(const McapChunk& chunk) const;

  const ByteSource& bytes_;
  std::filesystem::path path_;
  std::vector<McapChunk> chunks_;
  mutable std::mutex mutex_;
  mutable std::list<std::pair<std::uint32_t, std::shared_ptr<const std::string>>> kept_;
  mutable std::map<std::uint32_t, bool> has_right_crc_;  ///< for chunks that were read
};

}  // namespace redrive::rosbag
