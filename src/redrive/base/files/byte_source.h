// SPDX-License-Identifier: Apache-2.0
// A file whose parts are read where they are needed; tests and fuzzing read from memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>

namespace redrive {

/// Bytes that are read where they are needed.
class ByteSource {
 public:
  virtual ~ByteSource() = default;
  virtual std::uint64_t size() const = 0;
  /// Returns `size` bytes from `offset` on, fewer at the end. InputError if it cannot be read.
  virtual std::string read(std::uint64_t offset, std::size_t size) const = 0;
};

/// Bytes in memory.
class StringBytes : public ByteSource {
 public:
  explicit StringBytes(std::string bytes) : bytes_(std::move(bytes)) {}
  std::uint64_t size() const override { return bytes_.size(); }
  std::string read(std::uint64_t offset, std::size_t size) const override {
    return offset >= bytes_.size() ? "" : bytes_.substr(offset, size);
  }

 private:
  std::string bytes_;
};

/// InputError if the file is missing, unreadable or no regular file.
std::unique_ptr<ByteSource> open_bytes(const std::filesystem::path& path);

}  // namespace redrive
