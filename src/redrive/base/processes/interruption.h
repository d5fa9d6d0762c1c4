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

/// Throws Interrupted if a signal came, unless stop_on_signal was called. ThreadPool calls it
/// before each chunk.
void check_interruption();

}  // namespace redrive
