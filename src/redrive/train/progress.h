// SPDX-License-Identifier: Apache-2.0
// The line that shows the progress of training.
#pragma once

#include <cstdint>
#include <string>

namespace redrive {

struct ProgressState {
  std::int64_t step = 0, steps = 0;  ///< steps: number of the whole run; 0: limited by time
  double loss = 0, psnr_db = 0, rays_per_s = 0, seconds_left = 0;
};

/// Returns "step 1200/5000  loss 0.0123  21.2 dB  35400 rays/s  ETA 1:02:03".
std::string progress_line(const ProgressState& state);

}  // namespace redrive
