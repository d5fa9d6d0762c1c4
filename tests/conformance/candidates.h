// SPDX-License-Identifier: Apache-2.0
// Whom the conformance tests test, and random numbers for them.
#pragma once

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "nerf_case.h"

namespace redrive::kernels::conformance {

struct Candidate {
  std::string name;
  std::optional<Isa> isa;  ///< none: ref

  double roundoff() const { return isa == Isa::kAmxBf16 || isa == Isa::kAvx512Bf16 ? kBf16Roundoff : kFp32Roundoff; }
  /// Of the grid's networks, which have no tiles.
  double grid_roundoff() const { return isa == Isa::kAvx512Bf16 ? kBf16Roundoff : kFp32Roundoff; }
};
inline void PrintTo(const Candidate& candidate, std::ostream* out) { *out << candidate.name; }

inline std::vector<Candidate> candidates() {
  std::vector<Candidate> all = {{"ref", std::nullopt}};
  for (const Isa isa : all_isas()) all.push_back({std::string(isa_name(isa)), isa});
  return all;
}
inline std::string name_of(const testing::TestParamInfo<Candidate>& info) {
  std::string name = info.param.name;
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
}

/// Its tests are of one candidate each, skipped with the obstacle where the processor cannot run it.
class OneCandidate : public testing::TestWithParam<Candidate> {
 protected:
  void SetUp() override {
    if (!GetParam().isa) return;
    if (const auto obstacle = isa_obstacle(*GetParam().isa)) GTEST_SKIP() << GetParam().name << ": " << *obstacle;
  }
  std::unique_ptr<Backend> make(int threads = 2) const {
    return GetParam().isa ? make_cpu_backend(*GetParam().isa, threads) : make_ref_backend();
  }
};

// Sanitizers slow the oracle's loops down fifteenfold: a few sizes reach every line, and races show at any width.
#if defined(__SANITIZE_THREAD__) || defined(__SANITIZE_ADDRESS__)
constexpr bool kSanitized = true;
#else
constexpr bool kSanitized = false;
#endif

struct BatchSize {
  int n_rays, per_ray;
};
inline std::string trace(const BatchSize& size) {
  return std::to_string(size.n_rays) + " x " + std::to_string(size.per_ray);
}

inline std::vector<float> random_floats(std::size_t size, std::uint64_t stream, double low, double high) {
  std::vector<float> out(size);
  for (std::size_t i = 0; i < size; ++i)
    out[i] = static_cast<float>(low + (high - low) * 0.5 * (1 + uniform(stream, i)));
  return out;
}

}  // namespace redrive::kernels::conformance
