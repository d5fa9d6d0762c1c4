// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/xz.h"

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

}  // namespace redrive
