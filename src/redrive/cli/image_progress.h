// SPDX-License-Identifier: Apache-2.0
// Returns a callback that prints "3/12 images scored" on a terminal; an empty one where standard
// error is not a terminal.
#pragma once

#include <cstdio>
#include <functional>

#include <unistd.h>

namespace redrive {

inline std::function<void(int, int)> image_progress() {
  if (!isatty(STDERR_FILENO)) return {};
  return [](int done, int total) {
    std::fprintf(stderr, "\r%d/%d images scored%s", done, total, done == total ? "\n" : "");
  };
}

}  // namespace redrive
