// SPDX-License-Identifier: Apache-2.0
// Compression of whole byte strings as .xz files, by liblzma.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

namespace redrive {

/// Returns an .xz file of these bytes; equal bytes give equal files.
std::string xz(std::string_view bytes);

/// Returns the bytes of an .xz file; nothing if it is damaged or holds more than `most` bytes.
std::optional<std::string> unxz_at_most(std::size_t most, std::string_view file);

}  // namespace redrive
