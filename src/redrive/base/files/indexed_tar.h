// SPDX-License-Identifier: Apache-2.0
// The .itar of NVIDIA's NCore: an ordinary tar (written as POSIX ustar) with an index of its
// members behind its end, so that one is read without walking through the others. After the two
// empty blocks come the index, xz(CBOR{"items": [name], "offset_datas": [byte], "sizes": [byte]}),
// padded to 512 bytes, and a block that begins with "itar", u32 1, u64 offset and u32 size of the
// index.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

#include "redrive/base/files/byte_source.h"
#include "redrive/base/files/unfinished.h"

namespace redrive {

/// A tar that is written member by member, whole or not at all.
class IndexedTarWriter {
 public:
  explicit IndexedTarWriter(const std::filesystem::path& path);  ///< IoError

  /// name: at most 255 characters, with a "/" among the last 101 where it has more than 100. bytes:
  /// fewer than 8 GiB. IoError for others.
  void add(const std::string& name, std::string_view bytes);
  void finish();  ///< writes the index; IoError

 private:
  void write(std::string_view bytes);
  void fill_block();

  std::filesystem::path path_;
  UnfinishedFile file_;
  std::uint64_t written_ = 0;  ///< bytes
  nlohmann::json items_ = nlohmann::json::array(), offsets_ = nlohmann::json::array(),
                 sizes_ = nlohmann::json::array();
};

/// Reads the members that the index lists. Usable from any thread.
class IndexedTar {
 public:
  struct Member {
    std::uint64_t offset = 0, size = 0;  ///< bytes
  };

  /// `path` is for messages. InputError: no index, as in a file that was cut, or a damaged one;
  /// members beyond the file's end.
  IndexedTar(std::unique_ptr<const ByteSource> bytes, std::filesystem::path path);

  const std::map<std::string, Member>& members() const { return members_; }
  /// Returns the first `most` bytes of a member. InputError.
  std::string read(const Member& member, std::size_t most) const;

 private:
  [[noreturn]] void fail(const std::string& field, const std::string& value,
                         const std::string& rule) const;

  std::unique_ptr<const ByteSource> bytes_;
  std::filesystem::path path_;
  std::map<std::string, Member> members_;
};

}  // namespace redrive
