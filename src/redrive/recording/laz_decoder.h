// SPDX-License-Identifier: Apache-2.0
// The compressed points of a LAZ file: chunks of equally many points that know nothing of each
// other, and a table of their sizes behind them.
//   int64 position of the table | chunk ... chunk | uint32 version (0), uint32 number of chunks,
//   their sizes in bytes (coded)
// A chunk is its first point as it is, and the code of the others.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

#include "redrive/recording/laz_items.h"

namespace redrive {

constexpr std::size_t kLasRecordBytes = 28;

/// One stored record; `bytes` holds at least kLasRecordBytes.
LasRecord las_record(std::string_view bytes);

struct LazLayout {
  std::size_t begin = 0;     ///< of the points in the file, where the position of the table stands
  std::uint32_t points = 0;  ///< in the whole file
  std::uint32_t points_per_chunk = 0;  ///< > 0; the last chunk may have fewer
};

/// All points of the LAZ file `bytes`. InputError (`file` is for its text) if table, sizes and
/// codes do not fit together. Memory grows with what was decoded, not with what the file promises.
std::vector<LasRecord> decode_laz(std::string_view bytes, const LazLayout& layout,
                                  const std::filesystem::path& file);

}  // namespace redrive
