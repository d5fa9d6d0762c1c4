// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/xz.h"

#include <algorithm>
#include <cstdint>

#include <lzma.h>

#include "redrive/base/error.h"

namespace redrive {

std::string xz(std::string_view bytes) {
  std::string file(lzma_stream_buffer_bound(bytes.size()), '\0');
  std::size_t size = 0;
  const lzma_ret result =
      lzma_easy_buffer_encode(LZMA_PRESET_DEFAULT, LZMA_CHECK_CRC64, nullptr,
                              reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size(),
                              reinterpret_cast<std::uint8_t*>(file.data()), &size, file.size());
  REDRIVE_CHECK_OP(static_cast<int>(result), ==, static_cast<int>(LZMA_OK));
  file.resize(size);
  return file;
}

std::optional<std::string> unxz_at_most(std::size_t most, std::string_view file) {
  constexpr std::uint64_t kMemory = std::uint64_t{1} << 28;  // the largest preset takes 65 MiB
  lzma_stream stream = LZMA_STREAM_INIT;
  if (lzma_stream_decoder(&stream, kMemory, 0) != LZMA_OK) return std::nullopt;
  stream.next_in = reinterpret_cast<const std::uint8_t*>(file.data());
  stream.avail_in = file.size();
  std::string bytes;
  lzma_ret result = LZMA_OK;
  while (result == LZMA_OK && bytes.size() <= most) {
    constexpr std::size_t kStep = std::size_t{1} << 18;
    const std::size_t had = bytes.size();
    bytes.resize(had + std::max(kStep, had));
    stream.next_out = reinterpret_cast<std::uint8_t*>(bytes.data()) + had;
    stream.avail_out = bytes.size() - had;
    result = lzma_code(&stream, LZMA_FINISH);
    bytes.resize(bytes.size() - stream.avail_out);
  }
  lzma_end(&stream);
  if (result != LZMA_STREAM_END || bytes.size() > most) return std::nullopt;
  return bytes;
}

}  // namespace redrive
