// SPDX-License-Identifier: Apache-2.0
// What the processor can do at best: multiply-adds from registers, with the instruction the kernels use.
#pragma once

#include <optional>

#include "redrive/base/parallel.h"

#include "redrive/base/cpu_features.h"

namespace redrive::bench {

/// GFLOP/s of all threads together (a multiply-add is two), the best of several runs of about 20 ms. Measured with 256- or
/// 512-bit fp32 FMA, vdpbf16ps or tdpbf16ps; without an ISA with what any x86-64 has (SSE2). The ISA must be usable here.
double measure_peak_gflops(std::optional<Isa> isa, ThreadPool& pool);

// One per ISA, each in a file with that ISA's flags: `iterations` rounds of independent multiply-adds; returns their
// floating-point operations. Enough accumulators to hide the latency: 2 units x 4..6 cycles for FMA and vdpbf16ps (12 and more), 52 cycles
// at 16 a piece for tdpbf16ps (4).
namespace portable {
double multiply_add(long iterations);
}
namespace avx2 {
double multiply_add(long iterations);
}
namespace avx512 {
double multiply_add(long iterations);
}
namespace avx512_bf16 {
double multiply_add(long iterations);
}
namespace amx_bf16 {
double multiply_add(long iterations);
}

}  // namespace redrive::bench
