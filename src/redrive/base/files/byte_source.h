// SPDX-License-Identifier: Apache-2.0
// A file whose parts are read where they are needed; tests and fuzzing read from memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

namespace redrive {

/// Bytes that are read where they are needed.
class ByteSource {
 public:
  virtual ~ByteSource() = default;
  virtual std::uint64_t size() const = 0;
  /// Returns `size` bytes from `offset` on, fewer at the end. InputError if it cannot be read.
  virtual std::string read(std::uint64_t offset, std::size_t size) const = 0;
};

/// InputError if the file is missing, unreadable or no regular file.
std::unique_ptr<ByteSource> open_bytes(const std::filesystem::path& path);

}  // namespace redrive
