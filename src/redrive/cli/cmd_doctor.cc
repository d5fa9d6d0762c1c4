// SPDX-License-Identifier: Apache-2.0
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>

#include <unistd.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/cli/command.h"
#include "redrive/cli/json_output.h"
#include "redrive/kernels/backend.h"

namespace redrive {
namespace {

/// Uses the keys of bench --json.
void print_machine_json(std::int64_t memory_bytes) {
  const auto backend = kernels::make_backend({});
  nlohmann::json isas;
  for (const Isa isa : all_isas()) {
    const auto obstacle = isa_obstacle(isa);
    isas[std::string(isa_name(isa))] = {{"usable", !obstacle},
                                        {"why", obstacle ? nlohmann::json(*obstacle) : nullptr}};
  }
  print_json(
      nlohmann::json{{"cpu", cpu_model_name()},
                     {"cores", hardware_threads()},
                     {"memory_bytes", memory_bytes},
                     {"isas", isas},
                     {"backend", backend->name()},
                     {"isa", backend->isa() ? std::string(isa_name(*backend->isa())) : "none"},
                     {"threads", backend->threads()}});
}

int doctor(bool json) {
  const std::int64_t memory_bytes = std::int64_t{sysconf(_SC_PHYS_PAGES)} * sysconf(_SC_PAGESIZE);
  if (json) {
    print_machine_json(memory_bytes);
    return kExitOk;
  }
  std::printf("processor    %s\n", cpu_model_name().c_str());
  std::printf("cores        %d for this process\n", hardware_threads());
  std::printf("memory       %.1f GiB\n", 0x1p-30 * static_cast<double>(memory_bytes));
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

Action configure_doctor(CLI::App& command) {
  auto json = std::make_shared<bool>(false);
  add_json_option(command, json.get());
  return [json] { return doctor(*json); };
}

}  // namespace redrive
