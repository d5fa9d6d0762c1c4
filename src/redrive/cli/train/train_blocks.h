// SPDX-License-Identifier: Apache-2.0
// Training of a divided run by one process or by all that a launcher started: process 0 leads, the
// others follow.
#pragma once

#include <functional>
#include <memory>

#include "redrive/base/processes/process_group.h"
#include "redrive/kernels/backend.h"
#include "redrive/train/divided_run.h"
#include "redrive/train/training_data.h"

namespace redrive {

/// Returns the threads and the memory that a process may use: its part where several share a
/// machine.
BlockResources block_resources(const ProcessGroup& group, const TrainOptions& options);

/// Returns the options with the threads and the device of this process.
TrainOptions options_here(const ProcessGroup& group, const TrainOptions& options);

/// Backend and data of a run that a process of the group trains with its part of the machine.
struct TrainingSetup {
  std::unique_ptr<kernels::Backend> backend;
  TrainingData training;
};
TrainingSetup set_up_training(const ProcessGroup& group, Run& run, bool data_parallel);

/// Joins the processes that a launcher started and returns the exit code: process 0 runs `lead`,
/// the others train blocks of `root` as process 0 tells them and return its code. An error of
/// `lead` is printed and ends all.
int with_processes(const std::filesystem::path& root,
                   const std::function<int(ProcessGroup&)>& lead);

/// Throws UsageError if a launcher started several processes, since one run without --data-parallel
/// cannot use them.
void check_one_process(const ProcessGroup& group);

/// Trains the unfinished blocks, as process 0, and compares their brightness. Prints how it ended
/// and returns the exit code. The caller holds the lock of the run.
int train_blocks(ProcessGroup& group, DividedRun* whole);

}  // namespace redrive
