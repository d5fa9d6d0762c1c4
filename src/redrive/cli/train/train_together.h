// SPDX-License-Identifier: Apache-2.0
// --data-parallel of train and resume: the processes that a launcher started compute the steps of
// one run together (train/distributed/data_parallel.h).
#pragma once

#include <filesystem>

#include "redrive/base/processes/process_group.h"
#include "redrive/cli/command.h"
#include "redrive/kernels/backend.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"

namespace redrive {

void add_data_parallel_option(CLI::App& command, bool* data_parallel);

/// Throws UsageError where several processes are of no use to the run, or cannot share its steps.
void check_together(const ProcessGroup& processes, const Run& run);

/// As process 0, trains a run whose folder is complete. Prints how it ended and returns the exit
/// code. An error ends all processes.
int lead_together(ProcessGroup& processes, Run* run, const TrainingData& training,
                  kernels::Backend& backend);

/// As another process, trains the run in `root` along. It writes and prints nothing but an error,
/// which ends all processes.
void follow_together(ProcessGroup& processes, const std::filesystem::path& root);

}  // namespace redrive
