// SPDX-License-Identifier: Apache-2.0
// Backends under test, and random numbers for the tests.
#pragma once

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "nerf_case.h"
#include "redrive/kernels/device/cuda_backend.h"

namespace redrive::kernels::conformance {

// Sanitizers slow the oracle's loops down fifteenfold. A few sizes reach every line, and races show
// at any width.
#if defined(__SANITIZE_THREAD__) || defined(__SANITIZE_ADDRESS__)
constexpr bool kSanitized = true;
#else
constexpr bool kSanitized = false;
#endif

struct Candidate {
  /// "ref", an instruction set of the cpu backend, "loop" (functors of kernels/device on the host)
  /// or "cuda"; the last two also with "-fp32".
  std::string name;
  std::optional<Isa> isa;  ///< of the cpu backend

  bool is_oracle() const { return name == "ref"; }
  bool is_gpu() const { return name == "cuda" || name == "cuda-fp32"; }
  bool is_loop() const { return name == "loop" || name == "loop-fp32"; }
  bool is_slow() const { return is_oracle() || is_loop(); }
  /// A GPU before compute capability 8.0 has none and is more accurate than required.
  bool has_tensor_cores() const { return name == "loop" || name == "cuda"; }

  double roundoff() const {
    return isa == Isa::kAmxBf16 || isa == Isa::kAvx512Bf16 || has_tensor_cores() ? kBf16Roundoff
                                                                                 : kFp32Roundoff;
  }
  /// Unit roundoff of the grid's networks, which have no AMX path.
  double grid_roundoff() const {
    return isa == Isa::kAvx512Bf16 || has_tensor_cores() ? kBf16Roundoff : kFp32Roundoff;
  }
  /// Most multiply-adds of a batch. Plain loops take seconds where other backends take
  /// milliseconds.
  double most_macs() const { return is_slow() ? 1e8 : 1e300; }
  /// Whether gradients of a grid are summed in a fixed order. Threads of a GPU add the same terms
  /// in any order, which changes the last bits.
  bool adds_in_order() const { return !is_gpu(); }
  /// Largest difference, in ulps, of the error function from that of the C library, which the
  /// oracle uses: 4 and 3 by CUDA's and glibc's manuals.
  double error_function_ulps() const { return is_gpu() ? 7 : 0; }
};
inline void PrintTo(const Candidate& candidate, std::ostream* out) { *out << candidate.name; }

inline std::vector<Candidate> candidates() {
  std::vector<Candidate> all = {{"ref", std::nullopt}};
  for (const Isa isa : all_isas()) all.push_back({std::string(isa_name(isa)), isa});
  for (const char* const name : {"loop", "loop-fp32", "cuda", "cuda-fp32"})
    all.push_back({name, std::nullopt});
  return all;
}
inline std::string name_of(const testing::TestParamInfo<Candidate>& info) {
  std::string name = info.param.name;
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
}

/// Tests of one candidate, skipped with the obstacle where this machine cannot run it.
class BackendConformance : public testing::TestWithParam<Candidate> {
 protected:
  void SetUp() override {
    const auto obstacle = GetParam().isa        ? isa_obstacle(*GetParam().isa)
                          : GetParam().is_gpu() ? cuda_obstacle()
                                                : std::nullopt;
    if (obstacle) GTEST_SKIP() << GetParam().name << ": " << *obstacle;
#if defined(__SANITIZE_THREAD__)
    if (GetParam().is_slow()) GTEST_SKIP() << GetParam().name << ": it has one thread";
#endif
  }
  std::unique_ptr<Backend> make(int threads = 2) const {
    if (GetParam().isa) return make_cpu_backend(*GetParam().isa, threads);
    return GetParam().is_gpu()      ? make_cuda_backend(threads, GetParam().has_tensor_cores())
           : GetParam().is_oracle() ? make_ref_backend()
                                    : make_loop_backend(nullptr, GetParam().has_tensor_cores());
  }
};

struct BatchSize {
  int n_rays, per_ray;
};
inline std::string trace(const BatchSize& size) {
  return std::to_string(size.n_rays) + " x " + std::to_string(size.per_ray);
}

inline std::vector<float> random_floats(std::size_t size, std::uint64_t stream, double low,
                                        double high) {
  std::vector<float> out(size);
  for (std::size_t i = 0; i < size; ++i)
    out[i] = static_cast<float>(low + (high - low) * 0.5 * (1 + uniform(stream, i)));
  return out;
}

}  // namespace redrive::kernels::conformance
