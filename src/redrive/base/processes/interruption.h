// SPDX-License-Identifier: Apache-2.0
// Handles Ctrl-C and other signals that end the program.
#pragma once

#include <atomic>

namespace redrive {

/// Handles SIGINT, SIGTERM, SIGHUP and SIGUSR1, which mpirun forwards, from the program's start: it
/// ends at once with kExitInterrupted. Where a file or folder is unfinished
/// (base/files/unfinished.h), or was finished before, the next check_interruption throws instead,
/// so that no part is left and what only has to be printed is. A second SIGINT or SIGTERM ends the
/// program in any case. SIGPIPE and SIGXFSZ are ignored: writes fail instead.
void handle_signals();

/// Returns a flag that these signals set from now on, for a caller that checks it and ends its work
/// in order; the signals no longer end the program.
const std::atomic<bool>& stop_on_signal();

/// Sets that flag as a signal would.
void request_stop();

/// Lends SIGINT to a call from a program with a handler of its own, such as Python's: while it
/// lives, Ctrl-C sets a flag, which check_interruption turns into Interrupted, or with `looks` the
/// caller looks at. The last one that ends gives the signal back, and raises it again if it came.
/// Calls from several threads may overlap: all of them are interrupted.
class InterruptibleCall {
 public:
  explicit InterruptibleCall(bool looks = false);
  ~InterruptibleCall();
  InterruptibleCall(const InterruptibleCall&) = delete;
  InterruptibleCall& operator=(const InterruptibleCall&) = delete;

  static const std::atomic<bool>& came();  ///< the flag

 private:
  bool looks_;
};

/// Throws Interrupted if a signal came, unless stop_on_signal was called. ThreadPool calls it
/// before each chunk.
void check_interruption();

}  // namespace redrive
