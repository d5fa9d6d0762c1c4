// SPDX-License-Identifier: Apache-2.0
// In assembly, so that nothing is optimised away, spilled or reordered by any flags, and for every
// ISA. All operands are zero: these instructions take the same time for all but denormal values.
#include "redrive/bench/peak.h"

namespace redrive::bench {
#define REDRIVE_CLOBBERS                                                                   \
  "xmm0", "xmm1", "xmm2", "xmm3", "xmm4", "xmm5", "xmm6", "xmm7", "xmm8", "xmm9", "xmm10", \
      "xmm11", "xmm12", "xmm13", "xmm14", "xmm15"
#define REDRIVE_0_TO_11 "0,1,2,3,4,5,6,7,8,9,10,11"
#define REDRIVE_16_TO_27 "16,17,18,19,20,21,22,23,24,25,26,27"
#define REDRIVE_0_TO_15 REDRIVE_0_TO_11 ",12,13,14,15"

// Multiplies into six registers, adds into six others: 2 units of each kind on most processors, 4
// cycles of latency.
double sse2_multiply_add(long iterations) {
  __asm__ volatile(".irp r," REDRIVE_0_TO_15 "\n xorps %%xmm\\r, %%xmm\\r\n .endr\n" ::
                       : REDRIVE_CLOBBERS);
  for (long i = 0; i < iterations; ++i)
    __asm__ volatile(
        ".irp r,0,1,2,3,4,5\n mulps %%xmm15, %%xmm\\r\n .endr\n"
        ".irp r,6,7,8,9,10,11\n addps %%xmm14, %%xmm\\r\n .endr\n" ::
            : REDRIVE_CLOBBERS);
  return static_cast<double>(iterations) * 12 * 4;
}

// Twelve sums: 2 units x 4 cycles of latency keep eight in flight.
double avx2_multiply_add(long iterations) {
  __asm__ volatile("vzeroall" ::: REDRIVE_CLOBBERS);
  for (long i = 0; i < iterations; ++i)
    __asm__ volatile(".irp r," REDRIVE_0_TO_11
                     "\n vfmadd231ps %%ymm14, %%ymm15, %%ymm\\r\n .endr\n" ::
                         : REDRIVE_CLOBBERS);
  __asm__ volatile("vzeroupper" ::: REDRIVE_CLOBBERS);
  return static_cast<double>(iterations) * 12 * 8 * 2;
}

double avx512_multiply_add(long iterations) {
  __asm__ volatile("vzeroall" ::: REDRIVE_CLOBBERS);
  for (long i = 0; i < iterations; ++i)
    __asm__ volatile(".irp r," REDRIVE_0_TO_11
                     "\n vfmadd231ps %%zmm14, %%zmm15, %%zmm\\r\n .endr\n" ::
                         : REDRIVE_CLOBBERS);
  __asm__ volatile("vzeroupper" ::: REDRIVE_CLOBBERS);
  return static_cast<double>(iterations) * 12 * 16 * 2;
}

// Twenty-four: 2 units x 6 cycles need all of twelve and some slack (541 instead of 503 GFLOP/s on
// Zen 5). This file is compiled without AVX-512, so the compiler itself knows no zmm16..zmm27 to
// clobber.
double avx512_bf16_multiply_add(long iterations) {
  __asm__ volatile("vzeroall\n .irp r," REDRIVE_16_TO_27
                   "\n vpxord %%zmm\\r, %%zmm\\r, %%zmm\\r\n .endr\n" ::
                       : REDRIVE_CLOBBERS);
  for (long i = 0; i < iterations; ++i)
    __asm__ volatile(".irp r," REDRIVE_0_TO_11 "," REDRIVE_16_TO_27
                     "\n vdpbf16ps %%zmm14, %%zmm15, %%zmm\\r\n .endr\n" ::
                         : REDRIVE_CLOBBERS);
  __asm__ volatile("vzeroupper" ::: REDRIVE_CLOBBERS);
  return static_cast<double>(iterations) * 24 * 32 * 2;
}

}  // namespace redrive::bench
