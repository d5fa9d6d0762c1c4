// SPDX-License-Identifier: Apache-2.0
// Reads groups and arrays of zarr, version 2 of the format, in a folder or an indexed tar
// (base/files/indexed_tar.h). Source: the zarr storage specification, version 2.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace redrive {

/// The files of a store by key: their path relative to its root. Usable from any thread.
class ZarrFiles {
 public:
  virtual ~ZarrFiles() = default;
  virtual std::optional<std::uint64_t> size(const std::string& key) const = 0;  ///< bytes
  /// Returns the first `most` bytes of a file that is there.
  virtual std::string read(const std::string& key, std::size_t most) const = 0;
  /// Returns the names of the folders in a folder, sorted.
  virtual std::vector<std::string> folders(const std::string& within) const = 0;
};

/// Paths are relative to the root, which is "", without a "/" at their ends. Usable from any
/// thread.
class ZarrReader {
 public:
  /// A folder, or a file as an indexed tar. InputError: damaged, another version of the format.
  explicit ZarrReader(const std::filesystem::path& path);
  /// `path` is for messages.
  ZarrReader(std::unique_ptr<const ZarrFiles> files, const std::filesystem::path& path);

  const std::filesystem::path& path() const { return path_; }
  /// Returns the names of the groups and arrays right below a group, sorted.
  std::vector<std::string> names(const std::string& group) const { return files_->folders(group); }
  bool has_array(const std::string& array) const;
  /// Attributes of a group or an array, an object; empty where it has none. InputError.
  nlohmann::json attributes(const std::string& of) const;

  /// Shape and values, row-major. An array of numbers: integers, floats and booleans of up to 8
  /// bytes, at most 2^24; packed by Blosc, zlib, gzip or not at all. Integers above 2^53 are
  /// rounded. InputError names the array for others and for damage.
  struct Numbers {
    std::vector<std::size_t> shape;
    std::vector<double> values;
  };
  Numbers numbers(const std::string& array) const;

  /// Number of bytes of the file that an array without dimensions, of type "S", holds unpacked;
  /// nothing if there is none.
  std::optional<std::uint64_t> file_size(const std::string& array) const;
  /// The file's first `most` bytes. InputError where it is missing or packed.
  std::string file(const std::string& array, std::size_t most) const;

 private:
  nlohmann::json metadata(const std::string& key) const;
  [[noreturn]] void fail(const std::string& field, const std::string& value,
                         const std::string& rule) const;

  std::filesystem::path path_;
  std::unique_ptr<const ZarrFiles> files_;
};

}  // namespace redrive
