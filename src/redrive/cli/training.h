// SPDX-License-Identifier: Apache-2.0
// What train and resume share: Ctrl-C, what is printed before and after.
#pragma once

#include <atomic>

#include "redrive/kernels/backend_group.h"
#include "redrive/train/trainer.h"
#include "redrive/train/training_data.h"

namespace redrive {

/// Ctrl-C, SIGTERM or SIGHUP sets the flag; a second Ctrl-C or SIGTERM ends the program at once. A
/// reader of the output that goes away (SIGPIPE) ends nothing.
const std::atomic<bool>& stop_on_signal();

/// What the options choose to compute with. UsageError.
kernels::BackendGroup make_backends(const TrainOptions& options);

/// Says how much memory the run will need of what --memory allows, and on a GPU of what
/// --gpu-memory does; UsageError if that is too much.
void check_run_memory(const Run& run, const kernels::BackendGroup& team);

/// Backend, cameras and what is left out of their pictures, frames, pixels, training and held-out
/// views, steps.
void print_summary(const Run& run, const TrainingData& training, const kernels::BackendGroup& team);

/// Trains, says how it ended and how to go on; the exit code.
int train_to_end(Run* run, const TrainingData& training, const kernels::BackendGroup& team,
                 const std::atomic<bool>& stop);

}  // namespace redrive
