// SPDX-License-Identifier: Apache-2.0
// --backend, --isa, --device and --threads, the same for every command that computes.
#pragma once

#include <memory>
#include <string>

#include <CLI/App.hpp>

#include "redrive/base/error.h"
#include "redrive/cli/train_option.h"
#include "redrive/kernels/backend.h"
#include "redrive/model/method.h"

namespace redrive {

inline void add_backend_options(CLI::App& command, kernels::BackendChoice* choice) {
  add_train_option(command, "threads", &choice->threads);
  add_train_option(command, "backend", &choice->name);
  add_train_option(command, "isa", &choice->isa);
  add_train_option(command, "device", &choice->device);
}

/// Makes the backend for a method. UsageError: as kernels::make_backend, or it does not compute the
/// method.
inline std::unique_ptr<kernels::Backend> make_backend(kernels::BackendChoice choice,
                                                      const std::string& method) {
  choice.marches_rays = !find_method(method)->rasterises;
  std::unique_ptr<kernels::Backend> backend = kernels::make_backend(choice);
  if (choice.marches_rays && !backend->marches_rays())
    throw UsageError("--backend", choice.name,
                     "does not compute method " + method + ", which processors do: --backend cpu");
  return backend;
}

}  // namespace redrive
