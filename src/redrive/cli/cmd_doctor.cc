// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <optional>
#include <string>

#include <unistd.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/cli/command.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/kernels/device/nccl.h"
#include "redrive/kernels/self_test.h"

namespace redrive {
namespace {

/// Runs a GPU's self-test and returns its result as text.
std::string tested_gpu(int gpu) {
  const auto start = std::chrono::steady_clock::now();
  std::optional<std::string> failure;
  try {
    failure = kernels::self_test(*kernels::make_cuda_backend(1, true, gpu));
  } catch (const DeviceError& error) {
    failure = error.what();
  }
  if (failure) return "failed: " + *failure;
  char text[80];
  std::snprintf(text, sizeof text, "passed in %.1f s: the GPU agrees with the reference",
                std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  return text;
}

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
  const int gpus = kernels::cuda_gpus();
  for (int gpu = 0; gpu < std::max(1, gpus); ++gpu) {
    const auto no_cuda = kernels::cuda_obstacle(gpu);
    std::printf(
        "%-12s %s\n", (gpus > 1 ? "cuda " + std::to_string(gpu) : std::string("cuda")).c_str(),
        no_cuda ? ("no: " + *no_cuda).c_str() : ("yes: " + kernels::cuda_description(gpu)).c_str());
    if (!no_cuda) std::printf("self-test    %s\n", tested_gpu(gpu).c_str());
  }
  if (gpus > 1) {
    const auto no_nccl = kernels::nccl_obstacle();
    std::printf("nccl         %s\n", no_nccl ? ("no: " + *no_nccl + "; --gpus needs it").c_str()
                                             : ("yes: " + kernels::nccl_version()).c_str());
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
