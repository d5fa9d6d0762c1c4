// SPDX-License-Identifier: Apache-2.0
// What this processor and operating system allow. Compiled without ISA flags, so it runs anywhere.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace redrive {

/// Instruction sets the cpu backend has kernels for, slowest first.
enum class Isa {
  kAvx2,        ///< fp32, 8 lanes, FMA
  kAvx512,      ///< fp32, 16 lanes (F, BW, DQ, VL)
  kAvx512Bf16,  ///< bf16 products, fp32 sums by vdpbf16ps (Zen 4 and later; half rate on Intel)
  kAmxBf16      ///< bf16 products, fp32 sums by AMX tiles (Sapphire Rapids and later)
};

std::string_view isa_name(Isa isa);  ///< "avx2" "avx512" "avx512-bf16" "amx-bf16"
std::optional<Isa> isa_from_name(std::string_view name);
const std::vector<Isa>& all_isas();

/// Why `isa` cannot be used on this machine ("the processor lacks avx512f", "the kernel refused AMX
/// tile data", ...), or nothing if it can. Checks CPUID, XCR0 and, for AMX, asks Linux for the tile
/// state (arch_prctl ARCH_REQ_XCOMP_PERM), which a program must do before its first tile
/// instruction.
std::optional<std::string> isa_obstacle(Isa isa);

/// The fastest usable one: amx-bf16, else avx512-bf16 on AMD (on Intel vdpbf16ps is slower than
/// fp32 FMA), else avx512, else avx2; nothing on a processor without AVX2 (the ref backend still
/// runs there).
std::optional<Isa> best_isa();

std::string cpu_model_name();  ///< /proc/cpuinfo's "model name"
int hardware_threads();        ///< processors this process may run on (sched_getaffinity)

}  // namespace redrive
