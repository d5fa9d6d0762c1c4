// SPDX-License-Identifier: Apache-2.0
// What the processor can do at best: multiply-adds from registers, with the instruction the kernels
// use, and copies from memory to memory.
#pragma once

#include <optional>

#include "redrive/base/cpu_features.h"
#include "redrive/base/parallel.h"

namespace redrive::bench {

/// GFLOP/s of all threads together (a multiply-add is two), the sum of each thread's best of many
/// runs of 2 ms. Measured with 256- or 512-bit fp32 FMA, vdpbf16ps or tdpbf16ps; without an ISA
/// with what any x86-64 has (SSE2). The ISA must be usable here.
double measure_peak_gflops(std::optional<Isa> isa, ThreadPool& pool);

/// 1e9 bytes a second that all threads together copy from one place to another in memory, read and
/// written, at best; each 64 MiB of its own, all of them 256 MiB at least: more than a processor
/// has caches.
double measure_copy_gb_per_s(ThreadPool& pool);

// bench/peak_loops.cc, one per ISA: `iterations` rounds of independent multiply-adds; returns their
// floating-point operations.
double sse2_multiply_add(long iterations);
double avx2_multiply_add(long iterations);
double avx512_multiply_add(long iterations);
double avx512_bf16_multiply_add(long iterations);
double amx_bf16_multiply_add(long iterations);

}  // namespace redrive::bench
