// SPDX-License-Identifier: Apache-2.0
// The compressed points of a LAZ file: independent chunks of equally many points, and a table of
// their sizes in bytes at the end.
//   int64 offset of the table | chunk ... chunk | uint32 version (0), uint32 number of chunks,
//   coded sizes
// A chunk is its first point, not compressed, and the code of the others.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

#include "redrive/recording/laz_items.h"

namespace redrive {

constexpr std::size_t kLasRecordBytes = 28;

/// Parses one record; `bytes` holds at least kLasRecordBytes.
LasRecord las_record(std::string_view bytes);

struct LazLayout {
  std::size_t begin = 0;     ///< offset of the points in the file, where the table's offset stands
  std::uint32_t points = 0;  ///< in the whole file
  std::uint32_t points_per_chunk = 0;  ///< > 0; the last chunk may have fewer
};

/// Returns all points of the LAZ file `bytes`. InputError (`file` is for its text) if table, sizes
/// and codes contradict each other. Memory grows with the points decoded, not with the header's
/// count.
std::vector<LasRecord> decode_laz(std::string_view bytes, const LazLayout& layout,
                                  const std::filesystem::path& file);

}  // namespace redrive
