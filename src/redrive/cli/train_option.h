// SPDX-License-Identifier: Apache-2.0
// Options of train that other commands have, too, with the same help and the same range.
#pragma once

#include <string>
#include <type_traits>

#include <CLI/App.hpp>

#include "redrive/cli/help.h"
#include "redrive/cli/train/training.h"

namespace redrive {

/// Adds the option `name` of train to another command. `help`: in place of train's; empty: train's,
/// with range and default.
template <class T>
CLI::Option* add_train_option(CLI::App& command, const std::string& name, T* value,
                              const std::string& help = "") {
  const TrainField field = field_named(name);
  const std::string text = help.empty() ? help_text(field) : help;
  if constexpr (std::is_same_v<T, bool>) {
    return command.add_flag("--" + name, *value, text)->group(field.group);
  } else {
    CLI::Option* const option = command.add_option("--" + name, *value, text);
    option->type_name(field.value)->group(field.group);
    if (!field.choices.empty()) option->check(offering(field.choices));
    return option->check(CLI::Validator(
        [field](std::string& given) {
          TrainOptions options;
          field.parse(options, given);
          field.check(options);
          return std::string();
        },
        ""));
  }
}

}  // namespace redrive
