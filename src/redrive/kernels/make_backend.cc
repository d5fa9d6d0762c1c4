// SPDX-License-Identifier: Apache-2.0
// Chooses backend and instruction set of a run, or reports why a choice is impossible.
#include "redrive/kernels/backend.h"

#include "redrive/base/error.h"

namespace redrive::kernels {
namespace {

constexpr int kMaxThreads = 1024;

std::string joined(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text.empty() ? "none" : text;
}

std::string usable_isas() {
  std::vector<std::string> names;
  for (const Isa isa : all_isas())
    if (!isa_obstacle(isa)) names.emplace_back(isa_name(isa));
  return joined(names);
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

/// Returns the number of threads after checking the names of the choice.
int checked_threads(const BackendChoice& choice) {
  if (choice.threads < 0 || choice.threads > kMaxThreads)
    throw UsageError("--threads", std::to_string(choice.threads),
                     "must be 0 (all) to " + std::to_string(kMaxThreads));
  if (choice.name != "auto" && choice.name != "ref" && choice.name != "cpu" &&
      choice.name != "vulkan")
    throw UsageError("--backend", choice.name, "must be one of auto, ref, cpu, vulkan");
  if ((choice.name == "ref" || choice.name == "vulkan") && choice.isa != "auto")
    throw UsageError(
        "--isa", choice.isa,
        "the " + choice.name + " backend has no instruction sets; omit it or use --backend cpu");
  if (choice.name != "vulkan" && !choice.device.empty())
    throw UsageError("--device", choice.device, "chooses a device of --backend vulkan");
  return choice.threads > 0 ? choice.threads : hardware_threads();
}

}  // namespace

std::unique_ptr<Backend> make_backend(const BackendChoice& choice) {
  const int threads = checked_threads(choice);
  if (choice.name == "vulkan") return make_vulkan_backend(choice.device, threads);
  const std::optional<Isa> isa = choice.name == "ref" ? std::nullopt : choose_isa(choice.isa);
  if (choice.name == "cpu" && !isa)
    throw UsageError("--backend", choice.name, *isa_obstacle(Isa::kAvx2) + "; ref runs everywhere");
  if (!isa) return make_ref_backend();
  return make_cpu_backend(*isa, threads);
}

#ifndef REDRIVE_VULKAN
std::unique_ptr<Backend> make_vulkan_backend(const std::string&, int) {
  throw UsageError("--backend", "vulkan", "this build was made without it (docs/gpu.md)");
}
#endif

std::string describe(const Backend& backend) {
  std::string text = "backend=" + backend.name();
  if (backend.isa()) text += " isa=" + std::string(isa_name(*backend.isa()));
  if (!backend.device().empty()) text += " device=\"" + backend.device() + "\"";
  return text + " threads=" + std::to_string(backend.threads());
}

}  // namespace redrive::kernels
