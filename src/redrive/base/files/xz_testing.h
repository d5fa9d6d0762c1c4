// SPDX-License-Identifier: Apache-2.0
// For tests: reads .xz files and .itar files without the program's code.
#pragma once

#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <string_view>

#include <lzma.h>

namespace redrive {

inline std::string unxz(std::string_view file) {
  std::string bytes(std::size_t{1} << 26, '\0');
  std::uint64_t memory = UINT64_MAX;
  std::size_t in = 0, out = 0;
  if (lzma_stream_buffer_decode(
          &memory, 0, nullptr, reinterpret_cast<const std::uint8_t*>(file.data()), &in, file.size(),
          reinterpret_cast<std::uint8_t*>(bytes.data()), &out, bytes.size()) != LZMA_OK)
    throw std::runtime_error("no .xz file");
  bytes.resize(out);
  return bytes;
}

struct TarMember {
  std::size_t offset = 0;
  std::string bytes;
};

/// Walks through a tar's headers. `end`: offset behind its two empty blocks.
inline std::map<std::string, TarMember> walk_tar(const std::string& tar, std::size_t* end) {
  constexpr std::size_t kBlock = 512;
  const auto text = [&](std::size_t at, std::size_t most) {
    const std::string field = tar.substr(at, most);
    return field.substr(0, field.find('\0'));
  };
  std::map<std::string, TarMember> members;
  std::size_t at = 0;
  while (tar.at(at) != '\0') {
    unsigned sum = 0;
    for (std::size_t i = 0; i < kBlock; ++i)
      sum += i >= 148 && i < 156 ? ' ' : static_cast<unsigned char>(tar.at(at + i));
    if (sum != std::stoul(text(at + 148, 8), nullptr, 8)) throw std::runtime_error("checksum");
    if (text(at + 257, 6) != "ustar") throw std::runtime_error("magic");
    const std::string prefix = text(at + 345, 155);
    const std::size_t size = std::stoul(text(at + 124, 12), nullptr, 8);
    members[(prefix.empty() ? "" : prefix + "/") + text(at, 100)] = {at + kBlock,
                                                                     tar.substr(at + kBlock, size)};
    at += kBlock + (size + kBlock - 1) / kBlock * kBlock;
  }
  if (tar.substr(at, 2 * kBlock) != std::string(2 * kBlock, '\0'))
    throw std::runtime_error("no end");
  *end = at + 2 * kBlock;
  return members;
}

}  // namespace redrive
