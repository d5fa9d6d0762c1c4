// SPDX-License-Identifier: Apache-2.0
// --actors and --edit, the same for every command that shows moving objects.
#pragma once

#include <string>

#include <CLI/App.hpp>

namespace redrive {

/// Adds --actors and --edit.
inline void add_actor_options(CLI::App& command, std::string* actors, std::string* edit) {
  command
      .add_option("--actors", *actors,
                  "moving objects to draw: all, none, or the ids of some, such as 3,17 or -1")
      ->capture_default_str();
  command.add_option("--edit", *edit,
                     "moves, removes, hides, copies, adds and recolours moving objects");
}

}  // namespace redrive
