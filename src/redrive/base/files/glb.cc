// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/glb.h"

#include <bit>
#include <cstdint>
#include <cstring>

#include "redrive/base/error.h"

namespace redrive {

std::string glb_head(const nlohmann::json& json, std::size_t bin_bytes) {
  static_assert(std::endian::native == std::endian::little, "as the file");
  REDRIVE_CHECK_OP(bin_bytes % 4, ==, 0u);
  REDRIVE_CHECK_OP(bin_bytes, <=, kMostGlbBytes);
  constexpr std::uint32_t kVersion = 2, kHeaders = 28;
  std::string text = json.dump();
  text.resize((text.size() + 3) / 4 * 4, ' ');
  std::string bytes;
  const auto append = [&](std::size_t number) {
    const auto value = static_cast<std::uint32_t>(number);
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  bytes += "glTF";
  append(kVersion);
  append(kHeaders + text.size() + bin_bytes);
  append(text.size());
  bytes += "JSON" + text;
  append(bin_bytes);
  bytes.append("BIN\0", 4);
  return bytes;
}

}  // namespace redrive
