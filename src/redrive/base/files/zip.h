// SPDX-License-Identifier: Apache-2.0
// Zip files, by minizip: written without compression, read in place as a container.
#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/base/files/file_container.h"

namespace redrive {

struct ZipMember {
  std::string name;  ///< path within the zip
  std::string_view bytes;
};

/// Writes a zip whose members are stored, in this order and without times, so that equal members
/// give equal files. Their bytes begin at multiples of 64, as USDZ asks. Whole or not at all:
/// IoError as write_file.
void write_zip(const std::filesystem::path& path, std::span<const ZipMember> members);

/// The members of a zip, below the path of its file. Nothing is unpacked into a folder, so a name
/// such as "../x" is a name like any other.
class ZipFile : public FileContainer {
 public:
  /// InputError if it is no zip, is damaged, or has more than 100,000 members.
  explicit ZipFile(const std::filesystem::path& path);

  /// Names of the members, sorted. Of two with one name the last counts.
  std::vector<std::string> names() const;
  std::optional<std::uint64_t> size(const std::filesystem::path& path) const override;
  /// InputError if the member is damaged, encrypted, or of another size than the zip says.
  std::string read(const std::filesystem::path& path, std::size_t most) const override;

 private:
  struct Member {
    std::uint64_t offset = 0, number = 0;  ///< its place in the zip's directory
    std::uint64_t bytes = 0;
    bool encrypted = false;
  };
  const Member* find(const std::filesystem::path& path) const;

  std::filesystem::path path_;
  std::shared_ptr<void> zip_;
  std::map<std::string, Member> members_;
  mutable std::mutex mutex_;  ///< for zip_, which has one place to read at
};

}  // namespace redrive
