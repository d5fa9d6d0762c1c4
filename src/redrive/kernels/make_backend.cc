// SPDX-License-Identifier: Apache-2.0
// Chooses backend and instruction set of a run, or reports why a choice is impossible.
#include "redrive/kernels/backend_group.h"

#include "redrive/base/error.h"
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/kernels/device/nccl.h"
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
      choice.name != "cuda")
    throw UsageError("--backend", choice.name, "must be one of auto, ref, cpu, cuda");
  if ((choice.name == "ref" || choice.name == "cuda") && choice.isa != "auto")
    throw UsageError(
        "--isa", choice.isa,
        "the " + choice.name + " backend has no instruction sets; omit it or use --backend cpu");
  return choice.threads > 0 ? choice.threads : hardware_threads();
}

}  // namespace

std::unique_ptr<Backend> make_backend(const BackendChoice& choice) {
  const int threads = checked_threads(choice);
  if (choice.name == "cuda") {
    if (choice.rasterises)
      throw UsageError("--backend", choice.name,
                       "does not rasterise Gaussians yet; use --backend cpu or auto");
    if (const auto obstacle = cuda_obstacle())
      throw UsageError("--backend", choice.name, *obstacle);
    return make_cuda_backend(threads);
  }
  if (choice.name == "auto" && choice.isa == "auto" && !choice.rasterises && !cuda_obstacle())
    if (auto gpu = make_if_self_test_passes([&] { return make_cuda_backend(threads); })) return gpu;
  const std::optional<Isa> isa = choice.name == "ref" ? std::nullopt : choose_isa(choice.isa);
  if (choice.name == "cpu" && !isa)
    throw UsageError("--backend", choice.name, *isa_obstacle(Isa::kAvx2) + "; ref runs everywhere");
  if (!isa) return make_ref_backend();
  return make_cpu_backend(*isa, threads);
}

BackendGroup make_backend_group(const BackendChoice& choice, int gpus) {
  BackendGroup group;
  if (gpus == 1) {
    group.backends.push_back(make_backend(choice));
    return group;
  }
  const int threads = checked_threads(choice);
  const auto refuse = [&](const std::string& rule) {
    throw UsageError("--gpus", std::to_string(gpus), rule);
  };
  if (choice.rasterises) refuse("must be 1: GPUs do not rasterise Gaussians yet");
  const bool automatic = choice.name == "auto" && choice.isa == "auto";
  if (!automatic && choice.name != "cuda")
    refuse("must be 1 with --backend " + choice.name +
           (choice.isa == "auto" ? "" : " --isa " + choice.isa) +
           ", which computes on the processor");
  if (const auto obstacle = cuda_obstacle()) refuse("no GPU can be used: " + *obstacle);
  if (gpus > cuda_gpus())
    refuse("must be " + std::to_string(cuda_gpus()) + " or less: no more GPUs are visible");
  if (const auto obstacle = nccl_obstacle())
    refuse("needs NCCL (NVIDIA's package libnccl2), which is unavailable: " + *obstacle);
  for (int gpu = 0; gpu < gpus; ++gpu) {
    const std::string name = "GPU " + std::to_string(gpu) + ": ";
    if (const auto obstacle = cuda_obstacle(gpu)) refuse(name + *obstacle);
    group.backends.push_back(make_cuda_backend(threads, true, gpu));
    if (!automatic) continue;
    if (const auto failure = self_test(*group.backends.back()))
      refuse(name + "its self-test failed: " + *failure + "; --backend cuda uses it anyway");
  }
  group.reduction = make_nccl_all_reduce(group.backends);
  return group;
}

std::string describe(const Backend& backend) {
  std::string text = "backend=" + backend.name();
  if (backend.isa()) text += " isa=" + std::string(isa_name(*backend.isa()));
  return text + " threads=" + std::to_string(backend.threads());
}

}  // namespace redrive::kernels
