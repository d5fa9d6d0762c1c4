// SPDX-License-Identifier: Apache-2.0
// --backend, --isa and --threads, the same for every command that computes.
#pragma once

#include <CLI/App.hpp>

#include "redrive/base/error.h"
#include "redrive/cli/help.h"
#include "redrive/kernels/backend.h"
#include "redrive/train/files/options.h"

namespace redrive {

inline void add_backend_options(CLI::App& command, kernels::BackendChoice* choice) {
  // The options of train, whose fields have their help.
  for (const TrainField& field : train_fields()) {
    const auto add = [&](auto* value) {
      CLI::Option* option = command.add_option("--" + field.name, *value, help_text(field));
      if (!field.choices.empty()) option->check(one_of("--" + field.name, field.choices));
    };
    if (field.name == "backend") add(&choice->name);
    if (field.name == "isa") add(&choice->isa);
    if (field.name == "threads") add(&choice->threads);
  }
}

/// Creates the backend. Throws UsageError for --threads out of range, or as make_backend.
inline std::unique_ptr<kernels::Backend> make_checked_backend(
    const kernels::BackendChoice& choice) {
  if (choice.threads < 0 || choice.threads > 1024)
    throw UsageError("--threads", std::to_string(choice.threads), "must be in 0..1024");
  return kernels::make_backend(choice);
}

}  // namespace redrive
