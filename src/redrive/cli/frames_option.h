// SPDX-License-Identifier: Apache-2.0
// RUN, --frames, --cameras, --outside-files and --max-damaged of commands that take a run or a
// recording.
#pragma once

#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include <CLI/App.hpp>

#include "redrive/cli/train_option.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

inline void add_run_option(CLI::App& command, std::string* run) {
  command.add_option("RUN", *run, "run folder, as train makes it")->required();
}

inline void add_frames_option(CLI::App& command, std::string* frames) {
  add_train_option(command, "frames", frames);
}

inline void add_cameras_option(CLI::App& command, std::vector<std::string>* cameras) {
  add_train_option(command, "cameras", cameras)->delimiter(',');
}

inline void add_outside_files_option(CLI::App& command, bool* outside_files) {
  add_train_option(command, "outside-files", outside_files);
}

/// `percent`: a double, or an optional one in commands that take a run.
template <class Percent>
void add_max_damaged_option(CLI::App& command, Percent* percent) {
  const TrainField field = field_named("max-damaged");
  std::string help;
  if constexpr (std::is_same_v<Percent, std::optional<double>>)
    help = field.help + " (" + field.rule + "; default: what train was given, of a recording " +
           number_text(kMostDamagedPercent) + ")";
  add_train_option(command, "max-damaged", percent, help);
}

}  // namespace redrive
