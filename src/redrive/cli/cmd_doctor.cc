// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <string>

#include <unistd.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/cli/command.h"
#include "redrive/kernels/backend.h"

namespace redrive {
namespace {

int doctor() {
  const double memory_gib = 0x1p-30 * static_cast<double>(sysconf(_SC_PHYS_PAGES)) *
                            static_cast<double>(sysconf(_SC_PAGESIZE));
  std::printf("processor    %s\n", cpu_model_name().c_str());
  std::printf("cores        %d for this process\n", hardware_threads());
  std::printf("memory       %.1f GiB\n", memory_gib);
  for (const Isa isa : all_isas()) {
    const auto obstacle = isa_obstacle(isa);
    std::printf("%-12s %s\n", std::string(isa_name(isa)).c_str(),
                obstacle ? ("no: " + *obstacle).c_str() : "yes");
  }
  if (!best_isa())
    std::printf(
        "warning: no usable instruction set; only the slow reference backend runs on this "
        "machine\n");
  if (best_isa() == Isa::kAvx512 && !isa_obstacle(Isa::kAvx512Bf16))
    std::printf(
        "note: avx512-bf16 works here but is slower than avx512 on Intel processors; --isa "
        "avx512-bf16 selects it\n");
  std::printf("chosen       %s (the fastest of these; --backend and --isa select another)\n",
              describe(*kernels::make_backend({})).c_str());
  return kExitOk;
}

}  // namespace

Action configure_doctor(CLI::App&) { return doctor; }

}  // namespace redrive
