// SPDX-License-Identifier: Apache-2.0
// Chooses backend and instruction set of a run, or reports why a choice is impossible.
#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/device_info.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/self_test.h"

namespace redrive::kernels {
namespace {

constexpr int kMaxThreads = 1024;

std::string usable_isas() {
  std::vector<std::string> names;
  for (const Isa isa : all_isas())
    if (!isa_obstacle(isa)) names.emplace_back(isa_name(isa));
  return names.empty() ? "none" : joined(names);
}

std::string known_isas() {
  std::vector<std::string> names = {"auto"};
  for (const Isa isa : all_isas()) names.emplace_back(isa_name(isa));
  return joined(names);
}

/// Returns the chosen instruction set, or the best one; nothing where the processor has none.
std::optional<Isa> choose_isa(const std::string& name) {
  if (name == "auto") return best_isa();
  const std::optional<Isa> isa = isa_from_name(name);
  if (!isa) throw UsageError("--isa", name, "must be one of " + known_isas());
  if (const auto obstacle = isa_obstacle(*isa))
    throw UsageError("--isa", name, *obstacle + " (this machine offers " + usable_isas() + ")");
  return isa;
}

#ifndef REDRIVE_VULKAN
/// Runs that it has trained render without it.
std::unique_ptr<Backend> left_out(const BackendChoice& choice, int) {
  throw UsageError("--backend", choice.name, "this build was made without it (docs/gpu.md)");
}
#endif

std::unique_ptr<Backend> make_ref(const BackendChoice&, int) { return make_ref_backend(); }

std::unique_ptr<Backend> make_cpu(const BackendChoice& choice, int threads) {
  const std::optional<Isa> isa = choose_isa(choice.isa);
  if (!isa)
    throw UsageError("--backend", choice.name, *isa_obstacle(Isa::kAvx2) + "; ref runs everywhere");
  return make_cpu_backend(*isa, threads);
}

/// A backend that --backend names.
struct Entry {
  const char* name;
  bool has_isas;
  std::unique_ptr<Backend> (*make)(const BackendChoice& choice, int threads);
  /// Devices among which --device chooses and "auto" looks for a GPU; null: it has none.
  std::vector<DeviceInfo> (*devices)(std::string* reason) = nullptr;
  std::unique_ptr<Backend> (*make_on)(const std::string& device, int threads) = nullptr;
};
constexpr Entry kBackends[] = {
    {"ref", false, make_ref},
    {"cpu", true, make_cpu},
#ifdef REDRIVE_VULKAN
    {"vulkan", false, nullptr, list_vulkan_devices, make_vulkan_backend},
#else
    {"vulkan", false, left_out},
#endif
};

const Entry* find_backend(const std::string& name) {
  for (const Entry& entry : kBackends)
    if (name == entry.name) return &entry;
  return nullptr;
}

/// Returns the number of threads after checking the names of the choice.
int checked_threads(const BackendChoice& choice) {
  if (choice.threads < 0 || choice.threads > kMaxThreads)
    throw UsageError("--threads", std::to_string(choice.threads),
                     "must be 0 (all) to " + std::to_string(kMaxThreads));
  const Entry* const entry = find_backend(choice.name);
  if (choice.name != "auto" && !entry)
    throw UsageError("--backend", choice.name, "must be one of " + joined(backend_names()));
  if (entry && !entry->has_isas && choice.isa != "auto")
    throw UsageError(
        "--isa", choice.isa,
        "the " + choice.name + " backend has no instruction sets; omit it or use --backend cpu");
  if (!choice.device.empty() && !entry && choice.isa != "auto")
    throw UsageError("--isa", choice.isa, "GPUs, of which --device names one, have none");
  if (!choice.device.empty() && entry && !entry->make_on)
    throw UsageError("--device", choice.device,
                     "chooses a GPU; the " + choice.name + " backend computes on the processor");
  return choice.threads > 0 ? choice.threads : hardware_threads();
}

/// Opens a device unless it fails the self-test or lacks something: then says what in `fault`.
std::unique_ptr<Backend> open_tested(const Entry& entry, const DeviceInfo& device, std::size_t i,
                                     int threads, std::string* fault) {
  *fault = device.missing.empty() ? "" : "it lacks " + joined(device.missing);
  if (!fault->empty()) return nullptr;
  try {
    std::unique_ptr<Backend> backend = entry.make_on(std::to_string(i), threads);
    *fault = self_test(backend->gaussians());
    if (fault->empty()) return backend;
    *fault = "self-test, " + *fault;
  } catch (const DeviceError& error) {
    *fault = error.what();
  }
  return nullptr;
}

/// Returns the first GPU that passes the self-test, or null. note: why others did not.
std::unique_ptr<Backend> find_gpu(int threads, std::string* note) {
  for (const Entry& entry : kBackends) {
    if (!entry.devices) continue;
    std::string reason, fault;
    const std::vector<DeviceInfo> devices = entry.devices(&reason);
    for (std::size_t i = 0; i < devices.size(); ++i) {
      if (devices[i].is_cpu) continue;
      if (auto backend = open_tested(entry, devices[i], i, threads, &fault)) return backend;
      *note += (note->empty() ? "gpu " : "; gpu ") + std::to_string(i) + " (" + devices[i].name +
               ") is not used: " + fault;
    }
  }
  return nullptr;
}

/// Opens the device that --device names. UsageError: there is none, or it fails the self-test.
std::unique_ptr<Backend> named_gpu(const std::string& which, int threads) {
  std::string fault = "this build was made without a backend for GPUs (docs/gpu.md)";
  for (const Entry& entry : kBackends) {
    if (!entry.devices) continue;
    const std::vector<DeviceInfo> devices = entry.devices(&fault);
    if (devices.empty()) break;
    const std::size_t i = choose_device(devices, which);
    if (auto backend = open_tested(entry, devices[i], i, threads, &fault)) return backend;
    fault = devices[i].name + ": " + fault;
  }
  throw UsageError("--device", which, fault);
}

}  // namespace

std::vector<std::string> backend_names() {
  std::vector<std::string> names = {"auto"};
  for (const Entry& entry : kBackends) names.emplace_back(entry.name);
  return names;
}

std::vector<DeviceInfo> list_devices(std::string* reason) {
  *reason = "this build was made without a backend for GPUs (docs/gpu.md)";
  for (const Entry& entry : kBackends)
    if (entry.devices) return entry.devices(reason);
  return {};
}

std::string device_fault(const DeviceInfo& device, std::size_t i) {
  std::string fault;
  for (const Entry& entry : kBackends)
    if (entry.devices) open_tested(entry, device, i, 1, &fault);
  return fault;
}

std::unique_ptr<Backend> make_backend(const BackendChoice& choice) {
  const int threads = checked_threads(choice);
  if (const Entry* const entry = find_backend(choice.name))
    return entry->make_on ? entry->make_on(choice.device, threads) : entry->make(choice, threads);
  if (!choice.device.empty()) return named_gpu(choice.device, threads);
  std::string note;
  if (!choice.marches_rays && choice.isa == "auto")
    if (std::unique_ptr<Backend> gpu = find_gpu(threads, &note)) return gpu;
  const std::optional<Isa> isa = choose_isa(choice.isa);
  std::unique_ptr<Backend> backend = isa ? make_cpu_backend(*isa, threads) : make_ref_backend();
  backend->note = note;
  return backend;
}

std::string identity(const Backend& backend) {
  std::string text = backend.name();
  if (backend.isa()) text += " " + std::string(isa_name(*backend.isa()));
  if (!backend.device().empty()) text += " " + backend.device() + ", driver " + backend.driver();
  return text;
}

std::string describe(const Backend& backend) {
  std::string text = "backend=" + backend.name();
  if (backend.isa()) text += " isa=" + std::string(isa_name(*backend.isa()));
  if (!backend.device().empty()) text += " device=\"" + backend.device() + "\"";
  text += " threads=" + std::to_string(backend.threads());
  return text + (backend.note.empty() ? "" : "; " + backend.note);
}

}  // namespace redrive::kernels
