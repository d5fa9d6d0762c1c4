// SPDX-License-Identifier: Apache-2.0
// Reads and writes files, whole or not at all.
#pragma once

#include <filesystem>
#include <initializer_list>
#include <span>
#include <string>
#include <string_view>

#include <nlohmann/json_fwd.hpp>

namespace redrive {

/// Returns the file's bytes. InputError if it is missing or unreadable.
std::string read_file(const std::filesystem::path& path);

/// Writes `path` atomically: a temporary file in its folder, fsync, rename. On IoError (disk full,
/// permissions, ...) the old file is untouched and no temporary is left.
void write_file(const std::filesystem::path& path, std::string_view bytes);
void write_file(const std::filesystem::path& path, std::span<const std::string_view> parts);

/// Whether the name ends in one of these, e.g. ".jpg"; ignores case.
bool has_extension(const std::filesystem::path& path,
                   std::initializer_list<std::string_view> extensions);

/// Parses JSON. InputError names the file and the parser's line and column.
nlohmann::json parse_json(std::string_view text, const std::filesystem::path& path);
nlohmann::json read_json(const std::filesystem::path& path);

}  // namespace redrive
