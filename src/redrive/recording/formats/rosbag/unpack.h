// SPDX-License-Identifier: Apache-2.0
// Decompresses a stream until enough of it is known.
#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <string>

namespace redrive::rosbag {

enum class Packing { kNone, kLz4, kZstd };

/// Returns the first `want` bytes of what LZ4 frames or Zstandard pack, fewer if there are not so
/// many; nothing for damaged ones. `next`: the next part of the stream, empty at its end.
std::optional<std::string> unpack_start(Packing packing, std::size_t want,
                                        const std::function<std::string()>& next);

}  // namespace redrive::rosbag
