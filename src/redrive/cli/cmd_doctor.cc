// SPDX-License-Identifier: Apache-2.0
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <unistd.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/cli/command.h"
#include "redrive/cli/json_output.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/device_info.h"

namespace redrive {
namespace {

/// The Vulkan devices, why there are none, and what hides one.
struct Gpus {
  std::vector<kernels::DeviceInfo> devices;
  std::string reason, note;
};
Gpus find_gpus() {
  Gpus found;
  found.devices = kernels::list_devices(&found.reason);
  found.note = kernels::hidden_nvidia(std::filesystem::exists("/proc/driver/nvidia"),
                                      std::getenv("NVIDIA_DRIVER_CAPABILITIES"), found.devices);
  return found;
}

void print_gpus() {
  const Gpus found = find_gpus();
  if (found.devices.empty()) std::printf("gpu          no: %s\n", found.reason.c_str());
  for (std::size_t i = 0; i < found.devices.size(); ++i) {
    const kernels::DeviceInfo& device = found.devices[i];
    std::printf("gpu %-8zu %s: %sdriver %s, Vulkan %s, %.1f GiB\n", i, device.name.c_str(),
                device.is_cpu ? "in software, " : "", device.driver.c_str(), device.api.c_str(),
                0x1p-30 * static_cast<double>(device.memory));
    const std::string fault = kernels::device_fault(device, i);
    if (fault.empty())
      std::printf("             passes the self-test\n");
    else
      std::printf("warning: gpu %zu cannot be used: %s\n", i, fault.c_str());
  }
  if (!found.note.empty()) std::printf("note: %s\n", found.note.c_str());
}

nlohmann::json gpus_json() {
  const Gpus found = find_gpus();
  nlohmann::json devices = nlohmann::json::array();
  for (std::size_t i = 0; i < found.devices.size(); ++i) {
    const kernels::DeviceInfo& device = found.devices[i];
    devices.push_back({{"name", device.name},
                       {"driver", device.driver},
                       {"vulkan", device.api},
                       {"software", device.is_cpu},
                       {"memory_bytes", device.memory},
                       {"lacks", device.missing},
                       {"fault", kernels::device_fault(device, i)}});
  }
  return {{"devices", devices}, {"why_none", found.reason}, {"note", found.note}};
}

/// Uses the keys of bench --json.
void print_machine_json(std::int64_t memory_bytes) {
  const auto backend = kernels::make_backend({.marches_rays = false});
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
                     {"gpus", gpus_json()},
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
  print_gpus();
  if (!best_isa())
    std::printf(
        "warning: no usable instruction set; only the slow reference backend runs on this "
        "machine\n");
  if (best_isa() == Isa::kAvx512 && !isa_obstacle(Isa::kAvx512Bf16))
    std::printf(
        "note: avx512-bf16 works here but is slower than avx512 on Intel processors; --isa "
        "avx512-bf16 selects it\n");
  std::printf(
      "chosen       %s (the fastest of these, for splat; --backend and --isa select another)\n",
      describe(*kernels::make_backend({.marches_rays = false})).c_str());
  return kExitOk;
}

}  // namespace

Action configure_doctor(CLI::App& command) {
  auto json = std::make_shared<bool>(false);
  add_json_option(command, json.get());
  return [json] { return doctor(*json); };
}

}  // namespace redrive
