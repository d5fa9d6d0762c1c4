// SPDX-License-Identifier: Apache-2.0
// Assembly instead of intrinsics: GCC 12 declares _tile_loadconfig as reading 8 bytes (of 64). The assembler needs no ISA flag.
#include <cstdint>
#include <cstring>

#include "redrive/bench/peak.h"

namespace redrive::bench::amx_bf16 {
namespace {

/// Operand of ldtilecfg (Intel SDM volume 1, 18.2): all eight tiles 16 rows of 64 bytes.
struct alignas(64) TileConfig {
  std::uint8_t palette = 1, start_row = 0, reserved[14] = {};
  std::uint16_t bytes_per_row[16] = {64, 64, 64, 64, 64, 64, 64, 64};
  std::uint8_t rows[16] = {16, 16, 16, 16, 16, 16, 16, 16};
};
static_assert(sizeof(TileConfig) == 64);

}  // namespace

double multiply_add(long iterations) {
  const TileConfig config;
  __asm__ volatile("ldtilecfg %0" : : "m"(config) : "memory");
  // Zeroed tiles: tdpbf16ps takes the same time for every value.
  __asm__ volatile(
      "tilezero %%tmm0\n tilezero %%tmm1\n tilezero %%tmm2\n tilezero %%tmm3\n"
      "tilezero %%tmm4\n tilezero %%tmm5\n tilezero %%tmm6\n tilezero %%tmm7\n" ::
          : "memory");
  for (long i = 0; i < iterations; ++i)
    __asm__ volatile(
        "tdpbf16ps %%tmm6, %%tmm4, %%tmm0\n tdpbf16ps %%tmm7, %%tmm4, %%tmm1\n"
        "tdpbf16ps %%tmm6, %%tmm5, %%tmm2\n tdpbf16ps %%tmm7, %%tmm5, %%tmm3\n" ::
            : "memory");
  __asm__ volatile("tilerelease" ::: "memory");
  return static_cast<double>(iterations) * 4 * (16 * 16 * 32 * 2);  // 16 x 16 sums of 32 products each
}

}  // namespace redrive::bench::amx_bf16
