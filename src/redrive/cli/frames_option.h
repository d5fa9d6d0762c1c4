// SPDX-License-Identifier: Apache-2.0
// RUN, --frames, --cameras, --outside-files and --max-damaged of commands that take a run or a
// recording.
#pragma once

#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include <CLI/App.hpp>

#include "redrive/cli/help.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

inline void add_run_option(CLI::App& command, std::string* run) {
  command.add_option("RUN", *run, "run folder, as train makes it")->required();
}

inline void add_frames_option(CLI::App& command, std::string* frames) {
  command.add_option("--frames", *frames,
                     "frame ids, both ends included, either may be empty: reads "
                     "these frames alone (default: all)");
}

inline void add_cameras_option(CLI::App& command, std::vector<std::string>* cameras) {
  command.add_option("--cameras", *cameras, "takes these cameras alone (default: all with images)")
      ->delimiter(',');
}

inline void add_outside_files_option(CLI::App& command, bool* outside_files) {
  command.add_flag(
      "--outside-files", *outside_files,
      "also reads images, masks and points that transforms.json names outside of its folder");
}

/// `percent`: a double, or an optional one in commands that take a run.
template <class Percent>
void add_max_damaged_option(CLI::App& command, Percent* percent) {
  const bool of_run = std::is_same_v<Percent, std::optional<double>>;
  CLI::Option* const option =
      command
          .add_option("--max-damaged", *percent,
                      std::string("percentage of a sensor's images, scans, poses or times that may "
                                  "be damaged or impossible and are left out; one always may, "
                                  "unless it is 0") +
                          (of_run ? " (default: of a run what train was given, else " +
                                        number_text(kMostDamagedPercent) + ")"
                                  : ""))
          ->type_name("PERCENT")
          ->check(within("--max-damaged", 0, 100));
  if constexpr (!of_run) option->capture_default_str();
}

}  // namespace redrive
