// SPDX-License-Identifier: Apache-2.0
// The memory available to this process.
#pragma once

#include <cstdint>
#include <filesystem>

namespace redrive {

/// Returns the machine's memory in bytes (MemTotal of /proc/meminfo) or, where lower, the limit of
/// this process's control group (version 1 or 2) or one above it. `root`: root of the file system,
/// for tests. IoError without a readable /proc/meminfo.
std::uint64_t memory_bytes(const std::filesystem::path& root = "/");

}  // namespace redrive
