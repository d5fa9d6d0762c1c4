// SPDX-License-Identifier: Apache-2.0
// The registry: which backend and instruction set a run gets, and why not another.
#include "redrive/kernels/kernels.h"

#include "redrive/base/error.h"
#include "redrive/kernels/cuda/cuda_backend.h"
#include "redrive/kernels/self_test.h"

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

/// The instruction set that was asked for, or the best one; nothing where the processor has none.
std::optional<Isa> choose_isa(const std::string& name) {
  if (name == "auto") return best_isa();
  const std::optional<Isa> isa = isa_from_name(name);
  if (!isa) throw UsageError("--isa", name, "must be one of " + known_isas());
  if (const auto obstacle = isa_obstacle(*isa))
    throw UsageError("--isa", name, *obstacle + " (this machine offers " + usable_isas() + ")");
  return isa;
}

}  // namespace

std::unique_ptr<Backend> make_backend(const BackendChoice& choice) {
  if (choice.threads < 0 || choice.threads > kMaxThreads)
    throw UsageError("--threads", std::to_string(choice.threads), "must be 0 (all) to " + std::to_string(kMaxThreads));
  if (choice.name != "auto" && choice.name != "ref" && choice.name != "cpu" && choice.name != "cuda")
    throw UsageError("--backend", choice.name, "must be one of auto, ref, cpu, cuda");
  if ((choice.name == "ref" || choice.name == "cuda") && choice.isa != "auto")
    throw UsageError("--isa", choice.isa,
                     "the " + choice.name + " backend has no instruction sets; leave it out or take --backend cpu");

  const int threads = choice.threads > 0 ? choice.threads : hardware_threads();
  if (choice.name == "cuda") {
    if (const auto obstacle = cuda_obstacle()) throw UsageError("--backend", choice.name, *obstacle);
    return make_cuda_backend(threads);
  }
  if (choice.name == "auto" && choice.isa == "auto" && !cuda_obstacle())
    if (auto gpu = unless_it_errs([&] { return make_cuda_backend(threads); })) return gpu;
  const std::optional<Isa> isa = choice.name == "ref" ? std::nullopt : choose_isa(choice.isa);
  if (choice.name == "cpu" && !isa)
    throw UsageError("--backend", choice.name, *isa_obstacle(Isa::kAvx2) + "; ref runs everywhere");
  if (!isa) return make_ref_backend();
  return make_cpu_backend(*isa, threads);
}

std::string describe(const Backend& backend) {
  std::string text = "backend=" + backend.name();
  if (backend.isa()) text += " isa=" + std::string(isa_name(*backend.isa()));
  return text + " threads=" + std::to_string(backend.threads());
}

}  // namespace redrive::kernels
