// SPDX-License-Identifier: Apache-2.0
// Measures the processor's peaks: multiply-adds from registers, with the kernels' instructions, and
// copies from memory to memory.
#pragma once

#include <optional>

#include "redrive/base/cpu_features.h"
#include "redrive/base/parallel.h"

namespace redrive::bench {

/// GFLOP/s of all threads together (a multiply-add is two), the sum of each thread's best of many
/// runs of 2 ms. Measured with 256- or 512-bit fp32 FMA or vdpbf16ps; without an ISA with
/// SSE2, which any x86-64 has. The ISA must be usable on this machine.
double measure_peak_gflops(std::optional<Isa> isa, ThreadPool& pool);

/// Returns the best rate, in 1e9 bytes per second read and written, at which all threads together
/// copy memory: 64 MiB per thread and at least 256 MiB in all, more than a processor's caches.
double measure_copy_gb_per_s(ThreadPool& pool);

// bench/peak_loops.cc, one per ISA: `iterations` rounds of independent multiply-adds; returns their
// floating-point operations.
double sse2_multiply_add(long iterations);
double avx2_multiply_add(long iterations);
double avx512_multiply_add(long iterations);
double avx512_bf16_multiply_add(long iterations);

}  // namespace redrive::bench
