// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/mcap_chunks.h"

#include <algorithm>
#include <optional>

#include <zlib.h>

#include "redrive/base/error.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive::rosbag {
namespace {

constexpr std::uint64_t kBlock = 1 << 18;  // stays in the cache

}  // namespace

std::uint32_t crc_of(std::string_view bytes, std::uint32_t before) {
  return static_cast<std::uint32_t>(
      ::crc32_z(before, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

std::uint32_t McapChunks::add(const McapChunk& chunk) {
  chunks_.push_back(chunk);
  return static_cast<std::uint32_t>(chunks_.size() - 1);
}

void McapChunks::check_size(const McapChunk& chunk, std::uint64_t start) const {
  const auto fail = [&](std::uint64_t bytes, const std::string& rule) {
    throw InputError(path_, "chunk",
                     std::to_string(bytes) + " bytes at byte " + std::to_string(start), rule);
  };
  if (chunk.bytes > kMaxChunkBytes || chunk.packed_bytes > kMaxChunkBytes)
    fail(std::max(chunk.bytes, chunk.packed_bytes), "a chunk has at most 2^30");
  if (chunk.packing == Packing::kNone && chunk.bytes != chunk.packed_bytes)
    fail(chunk.bytes, "without compression it has " + std::to_string(chunk.packed_bytes));
}

std::shared_ptr<const std::string> McapChunks::records(std::uint32_t index) const {
  constexpr std::size_t kKept = 4;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [kept, records] : kept_)
      if (kept == index) return records;
  }
  const auto records = std::make_shared<const std::string>(unpack(chunks_[index]));
  check_crc(index, [&] { return crc_of(*records); });
  const std::lock_guard lock(mutex_);
  kept_.emplace_front(index, records);
  if (kept_.size() > kKept) kept_.pop_back();
  return records;
}

void McapChunks::check_crc(std::uint32_t index) const {
  check_crc(index, [&] { return crc_in_file(chunks_[index]); });
}

void McapChunks::fail(std::uint64_t offset, std::string_view rule) const {
  throw InputError(path_, "chunk", "byte " + std::to_string(offset), rule);
}

std::string McapChunks::unpack(const McapChunk& chunk) const {
  std::uint64_t done = 0;
  std::optional<std::string> out =
      unpack_start(chunk.packing, static_cast<std::size_t>(chunk.bytes), [&] {
        const auto size = static_cast<std::size_t>(std::min(kBlock, chunk.packed_bytes - done));
        std::string part = size == 0 ? "" : bytes_.read(chunk.records + done, size);
        done += part.size();
        return part;
      });
  if (!out || out->size() < chunk.bytes)
    fail(chunk.records,
         std::string("has damaged ") + (chunk.packing == Packing::kLz4    ? "LZ4"
                                        : chunk.packing == Packing::kZstd ? "Zstandard"
                                                                          : "records"));
  return std::move(*out);
}

void McapChunks::check_crc(std::uint32_t index,
                           const std::function<std::uint32_t()>& computed) const {
  const McapChunk& chunk = chunks_[index];
  std::optional<bool> right;
  {
    const std::lock_guard lock(mutex_);
    if (const auto known = has_right_crc_.find(index); known != has_right_crc_.end())
      right = known->second;
  }
  if (!right) {
    const std::uint32_t stated = stated_crc(chunk);
    right = stated == 0 || stated == computed();
    const std::lock_guard lock(mutex_);
    has_right_crc_[index] = *right;
  }
  if (!*right) fail(chunk.records, "the CRC of its records is wrong");
}

/// Returns the CRC of the records of a chunk without compression.
std::uint32_t McapChunks::crc_in_file(const McapChunk& chunk) const {
  std::uint32_t crc = 0;
  for (std::uint64_t done = 0; done < chunk.bytes; done += kBlock)
    crc = crc_of(bytes_.read(chunk.records + done,
                             static_cast<std::size_t>(std::min(kBlock, chunk.bytes - done))),
                 crc);
  return crc;
}

/// The index of chunks has no CRC; the chunk has it before its compression.
std::uint32_t McapChunks::stated_crc(const McapChunk& chunk) const {
  if (chunk.crc != 0) return chunk.crc;
  const std::size_t name = chunk.packing == Packing::kLz4    ? 3
                           : chunk.packing == Packing::kZstd ? 4
                                                             : 0;
  const std::string bytes = bytes_.read(chunk.records - 16 - name, 4);
  return bytes.size() == 4 ? little_endian<std::uint32_t>(bytes, 0) : 0;
}

}  // namespace redrive::rosbag
