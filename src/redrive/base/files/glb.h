// SPDX-License-Identifier: Apache-2.0
// The container of a binary glTF 2.0 file (section 4.4 of its specification).
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

namespace redrive {

/// Largest `bin_bytes`: a file holds 4 GiB.
constexpr std::size_t kMostGlbBytes = 0xffffffff - (std::size_t{1} << 20);

/// Returns what precedes the bytes of the only buffer: the header, the JSON and the header of the
/// buffer. bin_bytes: a multiple of 4, at most kMostGlbBytes.
std::string glb_head(const nlohmann::json& json, std::size_t bin_bytes);

}  // namespace redrive
