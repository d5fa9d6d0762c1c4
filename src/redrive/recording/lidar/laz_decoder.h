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

#include "redrive/recording/lidar/laz_items.h"

namespace redrive {

/// What a record of a LAZ file has: always POINT10, of 20 bytes, then what follows here.
struct LazItems {
  bool gps_time = true, colours = false;  ///< GPSTIME11, of 8 bytes; RGB12, of 6
  std::size_t extra_bytes = 0;            ///< BYTE

  std::size_t record_bytes() const {
    return 20 + (gps_time ? 8u : 0u) + (colours ? 6u : 0u) + extra_bytes;
  }
};

/// Parses one record of point format 0 to 3; `bytes` holds at least its items.
LasRecord las_record(std::string_view bytes, const LazItems& items);

struct LazLayout {
  std::size_t begin = 0;     ///< offset of the points in the file, where the table's offset stands
  std::uint32_t points = 0;  ///< in the whole file
  std::uint32_t points_per_chunk = 0;  ///< > 0; the last chunk may have fewer
  LazItems items = {};
};

/// Returns all points of the LAZ file `bytes`. InputError (`file` is for its text) if table, sizes
/// and codes contradict each other. Colours and extra bytes are decoded and dropped. Memory grows
/// with the points decoded, not with the header's count.
std::vector<LasRecord> decode_laz(std::string_view bytes, const LazLayout& layout,
                                  const std::filesystem::path& file);

}  // namespace redrive
