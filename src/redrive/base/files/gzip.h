// SPDX-License-Identifier: Apache-2.0
// Compression of whole byte strings, by zlib.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

namespace redrive {

/// Returns a gzip file of these bytes, without a time, so that equal bytes give equal files.
std::string gzip(std::string_view bytes);

/// Returns the bytes of a gzip file or of a zlib stream; nothing if it is damaged or holds more
/// than `most` bytes.
std::optional<std::string> gunzip_at_most(std::size_t most, std::string_view file);

/// Returns the bytes of a gzip file that this program made or embeds; other files fail a check.
std::string gunzip(std::string_view file);

}  // namespace redrive
