// SPDX-License-Identifier: Apache-2.0
// Notes on what a recording lacks or has besides, one a line.
#pragma once

#include <cstdio>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/core/summary.h"
#include "redrive/scene/scene.h"

namespace redrive {

inline void print_notes(const Recording& recording) {
  for (const Finding& finding : recording.findings)
    std::printf("note: %s: %s\n", finding.subject.c_str(), finding.what.c_str());
  if (recording.metric)
    for (const Finding& finding : summarize_drive(recording.frames).findings)
      std::printf("note: %s: %s\n", finding.subject.c_str(), finding.what.c_str());
}

/// Prints the recording's notes, and counts frames that the scene leaves out.
inline void print_notes(const Recording& recording, const Scene& scene) {
  print_notes(recording);
  if (scene.unseen_frames > 0)
    std::printf("note: frames: %zu without an image of the chosen cameras, left out\n",
                scene.unseen_frames);
}

}  // namespace redrive
