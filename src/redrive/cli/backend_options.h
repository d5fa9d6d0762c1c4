// SPDX-License-Identifier: Apache-2.0
// --backend, --isa, --device and --threads, the same for every command that computes.
#pragma once

#include <CLI/App.hpp>

#include "redrive/cli/train_option.h"
#include "redrive/kernels/backend.h"
#include "redrive/train/run.h"

namespace redrive {

inline void add_backend_options(CLI::App& command, kernels::BackendChoice* choice) {
  add_train_option(command, "threads", &choice->threads);
  add_train_option(command, "backend", &choice->name);
  add_train_option(command, "isa", &choice->isa);
  add_train_option(command, "device", &choice->device);
}

}  // namespace redrive
