// SPDX-License-Identifier: Apache-2.0
// Prints "3/12 images scored" on a terminal; nothing where standard error is piped.
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
