// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/cpu_features.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <fstream>

#include <cpuid.h>
#include <sched.h>

namespace redrive {
namespace {

enum Register { kEax, kEbx, kEcx, kEdx };

/// Registers of one CPUID leaf; zeros where the processor has no such leaf.
std::array<std::uint32_t, 4> cpuid(std::uint32_t leaf, std::uint32_t subleaf) {
  std::array<std::uint32_t, 4> r{};
  __get_cpuid_count(leaf, subleaf, &r[kEax], &r[kEbx], &r[kEcx], &r[kEdx]);
  return r;
}

struct Feature {
  const char* name;
  std::uint32_t leaf, subleaf;
  Register reg;
  int bit;
};

bool has(const Feature& f) { return (cpuid(f.leaf, f.subleaf)[f.reg] >> f.bit) & 1; }

// Intel SDM volume 2, CPUID. Each ISA needs the features of the slower ones too.
constexpr Feature kAvx2Features[] = {{"osxsave", 1, 0, kEcx, 27},
                                     {"fma", 1, 0, kEcx, 12},
                                     {"f16c", 1, 0, kEcx, 29},
                                     {"avx2", 7, 0, kEbx, 5}};
constexpr Feature kAvx512Features[] = {{"avx512f", 7, 0, kEbx, 16},
                                       {"avx512dq", 7, 0, kEbx, 17},
                                       {"avx512bw", 7, 0, kEbx, 30},
                                       {"avx512vl", 7, 0, kEbx, 31}};
// The bf16 kernels transpose ReLU bits with GFNI and move bytes with VBMI and VBMI2.
constexpr Feature kAvx512Bf16Features[] = {{"avx512_bf16", 7, 1, kEax, 5},
                                           {"avx512_vbmi", 7, 0, kEcx, 1},
                                           {"avx512_vbmi2", 7, 0, kEcx, 6},
                                           {"gfni", 7, 0, kEcx, 8}};

/// Register states that the operating system saves (XGETBV with ECX = 0). Only where osxsave is
/// set.
std::uint64_t xcr0() {
  std::uint32_t low, high;
  __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return (std::uint64_t{high} << 32) | low;
}

template <std::size_t N>
std::optional<std::string> lacks(const Feature (&features)[N]) {
  for (const Feature& feature : features)
    if (!has(feature)) return std::string("the processor lacks ") + feature.name;
  return std::nullopt;
}

std::optional<std::string> state_not_saved(std::uint64_t mask, const char* registers) {
  if ((xcr0() & mask) == mask) return std::nullopt;
  return std::string("the operating system does not save the ") + registers + " registers (XCR0)";
}

std::optional<std::string> avx2_obstacle() {
  if (auto why = lacks(kAvx2Features)) return why;
  return state_not_saved(0x6, "AVX");  // SSE, AVX
}

std::optional<std::string> avx512_obstacle() {
  if (auto why = avx2_obstacle()) return why;
  if (auto why = lacks(kAvx512Features)) return why;
  return state_not_saved(0xE6, "AVX-512");  // and opmask, upper halves, upper sixteen
}

std::optional<std::string> avx512_bf16_obstacle() {
  if (auto why = avx512_obstacle()) return why;
  return lacks(kAvx512Bf16Features);
}

bool is_intel() {
  const auto r = cpuid(0, 0);
  return r[kEbx] == signature_INTEL_ebx && r[kEcx] == signature_INTEL_ecx &&
         r[kEdx] == signature_INTEL_edx;
}

}  // namespace

std::string_view isa_name(Isa isa) {
  switch (isa) {
    case Isa::kAvx2: return "avx2";
    case Isa::kAvx512: return "avx512";
    case Isa::kAvx512Bf16: return "avx512-bf16";
  }
  return "unknown";
}

std::optional<Isa> isa_from_name(std::string_view name) {
  for (const Isa isa : all_isas())
    if (isa_name(isa) == name) return isa;
  return std::nullopt;
}

const std::vector<Isa>& all_isas() {
  static const std::vector<Isa> isas{Isa::kAvx2, Isa::kAvx512, Isa::kAvx512Bf16};
  return isas;
}

std::optional<std::string> isa_obstacle(Isa isa) {
  switch (isa) {
    case Isa::kAvx2: return avx2_obstacle();
    case Isa::kAvx512: return avx512_obstacle();
    case Isa::kAvx512Bf16: return avx512_bf16_obstacle();
  }
  return "unknown ISA";
}

std::optional<Isa> best_isa() {
  for (const Isa isa : {Isa::kAvx512Bf16, Isa::kAvx512, Isa::kAvx2}) {
    if (isa == Isa::kAvx512Bf16 && is_intel()) continue;
    if (!isa_obstacle(isa)) return isa;
  }
  return std::nullopt;
}

std::string cpu_model_name() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    const std::size_t colon = line.find(": ");
    if (line.starts_with("model name") && colon != std::string::npos) return line.substr(colon + 2);
  }
  return "unknown processor";
}

int hardware_threads() {
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof(set), &set) != 0) return 1;
  return std::max(1, CPU_COUNT(&set));
}

}  // namespace redrive
