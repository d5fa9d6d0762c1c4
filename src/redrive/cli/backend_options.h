// SPDX-License-Identifier: Apache-2.0
// --backend, --isa and --threads, the same for every command that computes.
#pragma once

#include <CLI/App.hpp>

#include "redrive/base/error.h"
#include "redrive/kernels/backend.h"

namespace redrive {

inline void add_backend_options(CLI::App& command, kernels::BackendChoice* choice) {
  command.add_option("--backend", choice->name, "auto, ref (plain loops) or cpu (default: auto)");
  command.add_option("--isa", choice->isa,
                     "instruction set of the cpu backend: auto, avx2, avx512, avx512-bf16 or "
                     "amx-bf16 (default: auto)");
  command.add_option("--threads", choice->threads,
                     "0: all that this process may use (0..1024, default: 0)");
}

/// Creates the backend. Throws UsageError for --threads out of range, or as make_backend.
inline std::unique_ptr<kernels::Backend> make_checked_backend(
    const kernels::BackendChoice& choice) {
  if (choice.threads < 0 || choice.threads > 1024)
    throw UsageError("--threads", std::to_string(choice.threads), "must be in 0..1024");
  return kernels::make_backend(choice);
}

}  // namespace redrive
