// SPDX-License-Identifier: Apache-2.0
// Progress of training: one line on a terminal that is updated, a plain line every few seconds
// where the output is piped.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace redrive {

struct ProgressState {
  std::int64_t step = 0, steps = 0;  ///< steps: of the whole run; 0: limited by time
  double loss = 0, psnr_db = 0, rays_per_s = 0, seconds_left = 0;
};

/// Returns "step 1200/5000  loss 0.0123  21.2 dB  35400 rays/s  ETA 1:02:03".
std::string progress_line(const ProgressState& state);

class Progress {
 public:
  Progress();
  ~Progress() { finish(); }

  bool due() const;  ///< whether to print the next line (every 0.2 s on a terminal, 5 s elsewhere)
  void show(const ProgressState& state);  ///< prints the line now
  void finish();  ///< ends the live line, so that other output begins on its own

 private:
  using Clock = std::chrono::steady_clock;
  bool terminal_ = false, open_line_ = false;
  Clock::time_point next_;
};

}  // namespace redrive
