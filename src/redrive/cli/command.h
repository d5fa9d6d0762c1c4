// SPDX-License-Identifier: Apache-2.0
// A command of the program registers its options on its subcommand and returns the action to run
// once they are parsed. The action returns an exit code or throws one of the errors of
// base/error.h.
#pragma once

#include <functional>
#include <span>

#include <CLI/App.hpp>

namespace redrive {

using Action = std::function<int()>;

struct Command {
  const char* name;
  const char* summary;
  Action (*configure)(CLI::App& command);  ///< null: the command has subcommands
  const char* examples;                    ///< lines of the help
  /// progress text while no part shows its own; null: the command shows its own
  const char* work = nullptr;
  std::span<const Command> subcommands = {};  ///< the first is meant where none is named
};

Action configure_inspect(CLI::App& command);
Action configure_align(CLI::App& command);
Action configure_plan(CLI::App& command);
Action configure_train(CLI::App& command);
Action configure_resume(CLI::App& command);
Action configure_eval(CLI::App& command);
Action configure_render_image(CLI::App& command);
Action configure_render_mount(CLI::App& command);
Action configure_render_poses(CLI::App& command);
Action configure_render_path(CLI::App& command);
Action configure_render_lidar(CLI::App& command);
Action configure_export(CLI::App& command);
Action configure_simulate(CLI::App& command);
Action configure_figures(CLI::App& command);
Action configure_bench(CLI::App& command);
Action configure_view(CLI::App& command);
Action configure_serve(CLI::App& command);
Action configure_doctor(CLI::App& command);

}  // namespace redrive
