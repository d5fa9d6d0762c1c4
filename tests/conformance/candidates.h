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
#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"
#ifdef REDRIVE_VULKAN
#include "tests/vulkan/wrapped_api.h"
#endif

namespace redrive::kernels::conformance {

// Sanitizers slow the oracle's loops down fifteenfold. A few sizes reach every line, and races show
// at any width.
#ifdef REDRIVE_SANITIZED
constexpr bool kSanitized = true;
#else
constexpr bool kSanitized = false;
#endif

struct Candidate {
  std::string name;        ///< "ref", "vulkan", or an instruction set of the cpu backend
  std::optional<Isa> isa;  ///< instruction set of the cpu backend

  bool is_oracle() const { return name == "ref"; }
  bool is_vulkan() const { return name == "vulkan"; }
  /// Unit roundoff of the networks.
  double roundoff() const { return isa == Isa::kAvx512Bf16 ? kBf16Roundoff : kFp32Roundoff; }
  /// Most multiply-adds of a batch. Plain loops take seconds where other backends take
  /// milliseconds.
  double most_macs() const { return is_oracle() ? 1e8 : 1e300; }
};
inline void PrintTo(const Candidate& candidate, std::ostream* out) { *out << candidate.name; }

inline std::vector<Candidate> candidates() {
  std::vector<Candidate> all = {{"ref", std::nullopt}};
  for (const Isa isa : all_isas()) all.push_back({std::string(isa_name(isa)), isa});
  return all;
}
/// Backends that compute method splat, among them the first Vulkan device, software ones included,
/// where the build has them.
inline std::vector<Candidate> splat_candidates() {
  std::vector<Candidate> all = candidates();
#ifdef REDRIVE_VULKAN
  all.push_back({"vulkan", std::nullopt});
#endif
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
    const auto obstacle = GetParam().isa ? isa_obstacle(*GetParam().isa) : std::nullopt;
    if (obstacle) GTEST_SKIP() << GetParam().name << ": " << *obstacle;
#ifdef REDRIVE_VULKAN
    if (GetParam().is_vulkan()) {
      try {
        make_vulkan_backend("0", 1);
      } catch (const UsageError& error) {
        GTEST_SKIP() << error.what();
      }
      api_.emplace();
      api_->guards = true;
    }
#endif
#ifdef REDRIVE_THREAD_SANITIZER
    if (GetParam().is_oracle()) GTEST_SKIP() << GetParam().name << ": it has one thread";
#endif
  }
#ifdef REDRIVE_VULKAN
  void TearDown() override {
    if (!api_) return;
    EXPECT_EQ(api_->alive, 0) << "objects of Vulkan are left";
    EXPECT_EQ(api_->damaged_guards, 0) << "shaders wrote beside their buffers";
  }
  std::optional<vulkan::testing::WrappedApi> api_;  ///< guards, which shaders may not touch
#endif
  std::unique_ptr<Backend> make(int threads = 2) const {
    if (GetParam().isa) return make_cpu_backend(*GetParam().isa, threads);
#ifdef REDRIVE_VULKAN
    if (GetParam().is_vulkan()) return make_vulkan_backend("0", threads);
#endif
    return make_ref_backend();
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
