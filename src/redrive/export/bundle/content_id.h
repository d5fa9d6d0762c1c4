// SPDX-License-Identifier: Apache-2.0
// Identifiers made from the content, so that equal files have equal ones.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace redrive {

/// Returns 64 bits of all bytes (FNV-1a). `begin`: the hash of the bytes before them.
std::uint64_t hash_of(std::string_view bytes, std::uint64_t begin = 0xcbf29ce484222325ull);
/// Returns 16 hexadecimal digits.
std::string hash_text(std::uint64_t hash);
/// Returns a UUID of version 8 (RFC 9562: made from the content).
std::string uuid_of(std::uint64_t hash);

}  // namespace redrive
