// SPDX-License-Identifier: Apache-2.0
// Reads and writes numbers in little-endian bytes.
#pragma once

#include <bit>
#include <cstddef>
#include <cstring>
#include <string>
#include <string_view>

namespace redrive {

static_assert(std::endian::native == std::endian::little, "so is all that redrive runs on");

/// Reads a T at byte `offset`, which must be at most bytes.size() - sizeof(T).
template <class T>
T little_endian(std::string_view bytes, std::size_t offset) {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

template <class T>
void add_bytes(T value, std::string* bytes) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof value);
}

}  // namespace redrive
