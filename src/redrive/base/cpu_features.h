// SPDX-License-Identifier: Apache-2.0
// Instruction sets that this processor and operating system support. Compiled without ISA flags, so
// that it runs anywhere.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace redrive {

/// Instruction sets that the cpu backend has kernels for, slowest first.
enum class Isa {
  kAvx2,       ///< fp32, 8 lanes, FMA
  kAvx512,     ///< fp32, 16 lanes (F, BW, DQ, VL)
  kAvx512Bf16  ///< bf16 products, fp32 sums by vdpbf16ps (Zen 4 and later; half rate on Intel)
};

std::string_view isa_name(Isa isa);  ///< "avx2" "avx512" "avx512-bf16"
std::optional<Isa> isa_from_name(std::string_view name);
const std::vector<Isa>& all_isas();

/// Returns why `isa` cannot be used on this machine ("the processor lacks avx512f", ...), nothing
/// if it can. Checks CPUID and XCR0.
std::optional<std::string> isa_obstacle(Isa isa);

/// Returns the fastest usable ISA: avx512-bf16 on AMD (on Intel vdpbf16ps is slower than fp32 FMA),
/// else avx512, else avx2; nothing on a processor without AVX2, where the ref backend runs.
std::optional<Isa> best_isa();

std::string cpu_model_name();  ///< /proc/cpuinfo's "model name"
int hardware_threads();        ///< processors this process may run on (sched_getaffinity)

}  // namespace redrive
