// SPDX-License-Identifier: Apache-2.0
// Ends a fuzz target whose parser takes more processor time than a budget for each byte, as one
// whose time grows with the square of its input does. Linked to each target in front of its
// function (--wrap in fuzz/CMakeLists.txt).
#include <time.h>

#include <cstddef>
#include <cstdint>
#include <cstdio>

namespace {

// With sanitizers parsers take up to 0.4 microseconds a byte. Exceptions for damaged lines take
// more: kitti_times takes 6 s for 114 kB of empty lines. Decoders of images first take memory for
// all pixels. A parser whose time grows with the square takes minutes for 128 kB.
constexpr double kFirst_s = 2, kByte_s = 80e-6;

double thread_seconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// What came nearest to its budget; printed at the end.
struct Slowest {
  double share = 0, took_s = 0;
  std::size_t bytes = 0;
  ~Slowest() {
    std::fprintf(stderr, "slowest input: %.0f %% of its budget, %.3f s for %zu bytes\n",
                 100 * share, took_s, bytes);
  }
} slowest;

}  // namespace

extern "C" int __real_LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

extern "C" int __wrap_LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const double begin = thread_seconds();
  const int result = __real_LLVMFuzzerTestOneInput(data, size);
  const double took = thread_seconds() - begin,
               allowed = kFirst_s + kByte_s * static_cast<double>(size);
  if (took > allowed) {
    std::fprintf(stderr, "%.2f s of processor time for %zu bytes, %.2f allowed\n", took, size,
                 allowed);
    __builtin_trap();
  }
  if (took > slowest.share * allowed) {
    slowest.share = took / allowed;
    slowest.took_s = took;
    slowest.bytes = size;
  }
  return result;
}
