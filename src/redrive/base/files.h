// SPDX-License-Identifier: Apache-2.0
// Files: whole or not at all.
#pragma once

#include <filesystem>
#include <initializer_list>
#include <span>
#include <string>
#include <string_view>

#include <nlohmann/json_fwd.hpp>

namespace redrive {

/// The file's bytes. InputError if it is missing or unreadable.
std::string read_file(const std::filesystem::path& path);

/// Writes `path` atomically: a temporary beside it, fsync, rename. IoError (disk full, permissions
/// ...) leaves what stood there before untouched and no temporary behind.
void write_file(const std::filesystem::path& path, std::string_view bytes);

/// Whether the name ends in one of these, e.g. ".jpg", in capitals or not.
bool has_extension(const std::filesystem::path& path,
                   std::initializer_list<std::string_view> extensions);

/// Parses JSON. InputError names the file and the parser's line and column.
nlohmann::json parse_json(std::string_view text, const std::filesystem::path& path);
nlohmann::json read_json(const std::filesystem::path& path);

}  // namespace redrive
