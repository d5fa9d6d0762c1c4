// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/progress.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace redrive {

std::string progress_line(const ProgressState& state) {
  const auto left = static_cast<long long>(std::ceil(std::clamp(state.seconds_left, 0.0, 1e9)));
  char line[200], of_all[32] = "";
  if (state.steps > 0)
    std::snprintf(of_all, sizeof of_all, "/%lld", static_cast<long long>(state.steps));
  std::snprintf(line, sizeof line,
                "step %lld%s  loss %.5f  %.2f dB  %.0f rays/s  ETA %lld:%02lld:%02lld",
                static_cast<long long>(state.step), of_all, state.loss, state.psnr_db,
                state.rays_per_s, left / 3600, left / 60 % 60, left % 60);
  return line;
}

}  // namespace redrive
