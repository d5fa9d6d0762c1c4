// SPDX-License-Identifier: Apache-2.0
// Reads and writes files, whole or not at all.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <initializer_list>
#include <span>
#include <string>
#include <string_view>

#include <nlohmann/json_fwd.hpp>

namespace redrive {

// Maximum number of bytes that are read from a file, by its kind. Text becomes ten times its size
// in memory.
constexpr std::uint64_t kMaxTextBytes = std::uint64_t{1} << 28;   ///< JSON, calibrations, poses
constexpr std::uint64_t kMaxImageBytes = std::uint64_t{1} << 30;  ///< PNG, JPEG
constexpr std::uint64_t kMaxDataBytes = std::uint64_t{1} << 36;   ///< points, models, checkpoints

/// Returns the file's bytes. InputError if it is missing, unreadable, no regular file (a pipe, a
/// device), or has more than `most` bytes or than this machine's memory.
std::string read_file(const std::filesystem::path& path, std::uint64_t most = kMaxTextBytes);

/// Returns the file's first `size` bytes, fewer where it has fewer. InputError as read_file.
std::string read_head(const std::filesystem::path& path, std::size_t size);

/// The beginning and the end of a file, which overlap where it is small.
struct FileEnds {
  std::uint64_t bytes = 0;  ///< size of the file
  std::string head, tail;
};

/// Returns the file's first `head` and last `tail` bytes, fewer where it has fewer. Of a file in a
/// container there is no tail: it would cost reading the whole. InputError as read_file.
FileEnds read_ends(const std::filesystem::path& path, std::size_t head, std::size_t tail);

/// Calls `take` with one block of the file after the other, whatever its size. InputError as
/// read_file.
void read_blocks(const std::filesystem::path& path,
                 const std::function<void(std::string_view block)>& take);

/// Writes `path` atomically: a temporary file in its folder, fsync, rename. On IoError (disk full,
/// permissions, ...) the old file is untouched and no temporary is left.
void write_file(const std::filesystem::path& path, std::string_view bytes);
void write_file(const std::filesystem::path& path, std::span<const std::string_view> parts);

/// Makes the folders of the relative path `folders` within `root`. IoError where one of them is a
/// link or no folder: nothing is written outside of `root`.
void make_folders_within(const std::filesystem::path& root, const std::filesystem::path& folders);

/// Whether the name ends in one of these, e.g. ".jpg"; ignores case.
bool has_extension(const std::filesystem::path& path,
                   std::initializer_list<std::string_view> extensions);

/// Parses JSON of at most 64 levels in linear time. InputError names the file and the parser's line
/// and column.
nlohmann::json parse_json(std::string_view text, const std::filesystem::path& path);
nlohmann::json read_json(const std::filesystem::path& path);

}  // namespace redrive
