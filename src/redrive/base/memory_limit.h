// SPDX-License-Identifier: Apache-2.0
// How much memory there is for this process.
#pragma once

#include <cstdint>
#include <filesystem>

namespace redrive {

/// Bytes: the machine's (MemTotal of /proc/meminfo), or the least that a control group of this
/// process (version 1 or 2) or one above it allows. `root`: of the file system, for tests. IoError
/// without a readable /proc/meminfo.
std::uint64_t memory_bytes(const std::filesystem::path& root = "/");

}  // namespace redrive
