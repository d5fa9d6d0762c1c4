// SPDX-License-Identifier: Apache-2.0
// Lets readers drop damaged records of tables and text files one by one.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// Receives the damaged records of a sensor; where a function gets null, they are errors.
struct DamagedList {
  std::string sensor;
  std::vector<DamagedRecord>* records;
  mutable std::size_t parsed = 0, failed = 0;  ///< counted by parse_record
};

/// Runs `parse`, which reads a record, of a frame that it may set. Returns false where it throws an
/// InputError, which becomes a record of the list. It is thrown on without a list, and where most
/// records are damaged: then the file is of another kind.
template <class Parse>
bool parse_record(const DamagedList* damaged, const std::int64_t& frame_id, const Parse& parse) {
  if (!damaged) {
    parse();
    return true;
  }
  constexpr std::size_t kFew = 20;
  ++damaged->parsed;
  try {
    parse();
    return true;
  } catch (const InputError& error) {
    if (++damaged->failed > kFew && 2 * damaged->failed > damaged->parsed) throw;
    damaged->records->push_back({damaged->sensor, frame_id, error.what()});
    return false;
  }
}

/// Takes ids of frames out that the list names: its finding says why.
inline void take_out_named(const DamagedList& damaged, std::vector<std::int64_t>* ids) {
  std::erase_if(*ids, [&](std::int64_t id) {
    return std::ranges::any_of(*damaged.records, [&](const DamagedRecord& record) {
      return record.frame_id == id && record.sensor == damaged.sensor;
    });
  });
}

/// Records of a sequence that do not fit their neighbours.
struct Misfits {
  std::vector<std::size_t> single;  ///< indices: without them the others fit together
  std::vector<std::size_t> breaks;  ///< indices of records that do not fit the ones before
};

/// Finds the fewest records, eight in a row at most, without which each of `n` fits the one before.
/// `goes(a, b)`: whether record b may follow record a.
template <class Goes>
Misfits find_misfits(std::size_t n, const Goes& goes) {
  constexpr std::size_t kMostInRow = 8;
  Misfits misfits;
  std::vector<std::size_t> kept;
  std::size_t first = 0;  // in `kept`, behind the last break
  for (std::size_t i = 0; i < n; ++i) {
    bool fits = kept.size() == first || goes(kept.back(), i);
    for (std::size_t k = 1; k <= kMostInRow && !fits; ++k) {
      if (i + k > n) break;
      if (i + k == n || goes(kept.back(), i + k)) {  // without k records from here on
        for (std::size_t skipped = i; skipped < i + k; ++skipped) misfits.single.push_back(skipped);
        i += k;
        fits = true;
      } else if (kept.size() - first >= k &&
                 (kept.size() - first == k || goes(kept[kept.size() - 1 - k], i))) {
        misfits.single.insert(misfits.single.end(), kept.end() - std::ptrdiff_t(k), kept.end());
        kept.resize(kept.size() - k);
        fits = true;
      }
    }
    if (i == n) break;
    if (!fits) {
      misfits.breaks.push_back(i);
      first = kept.size();
    }
    kept.push_back(i);
  }
  std::ranges::sort(misfits.single);
  return misfits;
}

}  // namespace redrive
