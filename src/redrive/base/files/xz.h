// SPDX-License-Identifier: Apache-2.0
// Compression of whole byte strings as .xz files, by liblzma.
#pragma once

#include <string>
#include <string_view>

namespace redrive {

/// Returns an .xz file of these bytes; equal bytes give equal files.
std::string xz(std::string_view bytes);

}  // namespace redrive
