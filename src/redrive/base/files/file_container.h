// SPDX-License-Identifier: Apache-2.0
// Files that lie within others, such as images in a bag of ROS 2: read_file and read_head
// (base/files/files.h) find them by paths below the container's folder.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

namespace redrive {

/// Usable from any thread.
class FileContainer {
 public:
  virtual ~FileContainer() = default;
  /// Returns the size of a file in bytes, without reading it; nothing if there is no such file.
  virtual std::optional<std::uint64_t> size(const std::filesystem::path& path) const = 0;
  /// Returns the first `most` bytes of a file that is there. InputError for damage.
  virtual std::string read(const std::filesystem::path& path, std::size_t most) const = 0;
};

/// Makes the files of a container readable until the process ends or another one is mounted at the
/// folder.
void mount(const std::filesystem::path& folder, std::shared_ptr<const FileContainer> container);

/// Returns the container that has the file; null: none, it is a file of its own.
std::shared_ptr<const FileContainer> container_of(const std::filesystem::path& path);

/// Returns the size in bytes of a file, of a container or of its own; nothing if there is none.
std::optional<std::uint64_t> file_bytes(const std::filesystem::path& path);

}  // namespace redrive
