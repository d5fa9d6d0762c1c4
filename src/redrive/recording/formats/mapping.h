// SPDX-License-Identifier: Apache-2.0
// Recordings of no fixed layout, whose streams (topics) have to be mapped to sensors, by a file
// that is proposed and then edited.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace redrive {

struct Stream {
  std::string name, type, frame;  ///< the frame is its first message's, where it is known
  std::uint64_t messages = 0;
  std::int64_t first_ns = 0, last_ns = 0;  ///< recorded

  double rate_hz() const {
    return last_ns > first_ns && messages > 1
               ? 1e9 * static_cast<double>(messages - 1) / static_cast<double>(last_ns - first_ns)
               : 0;
  }
};

struct Mapping {
  std::vector<Stream> streams;         ///< sorted by name
  std::filesystem::path file;          ///< where the mapping stands, or is to stand
  bool is_there = false;               ///< then nothing is proposed
  std::string text;                    ///< proposed text of the file
  std::vector<std::string> questions;  ///< what has to be decided before the recording opens
};

/// Returns the mapping of a recording that needs one; nothing for other folders
/// (recording/registry.cc). InputError for a damaged recording.
std::optional<Mapping> mapping_of(const std::filesystem::path& root);

}  // namespace redrive
