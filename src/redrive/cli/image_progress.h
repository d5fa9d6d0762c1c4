// SPDX-License-Identifier: Apache-2.0
// Progress of a command that makes images.
#pragma once

#include <cstdio>
#include <functional>

#include <unistd.h>

namespace redrive {

/// Returns a callback that prints "3/12 images scored" on a terminal, where `verb` is "scored" and
/// `what` "images"; an empty one where standard error is not a terminal.
inline std::function<void(int, int)> image_progress(const char* verb, const char* what = "images") {
  if (!isatty(STDERR_FILENO)) return {};
  return [verb, what](int done, int total) {
    std::fprintf(stderr, "\r%d/%d %s %s%s", done, total, what, verb, done == total ? "\n" : "");
  };
}

}  // namespace redrive
