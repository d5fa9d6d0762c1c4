// SPDX-License-Identifier: Apache-2.0
// --frames of commands that take a recording.
#pragma once

#include <string>

#include <CLI/App.hpp>

#include "redrive/recording/frame_range.h"

namespace redrive {

inline void add_frames_option(CLI::App& command, std::string* frames) {
  command.add_option("--frames", *frames,
                     "FIRST:LAST[:STEP], frame ids, both ends included, either may be empty: reads "
                     "these frames alone (default: all)");
}

}  // namespace redrive
