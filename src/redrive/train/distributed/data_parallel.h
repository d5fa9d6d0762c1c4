// SPDX-License-Identifier: Apache-2.0
// Data parallelism: several processes compute every step together, each with a backend, a replica
// of the state and a batch of its own. The gradients are averaged, and each process applies the
// same update, so a step of N processes equals one of a single process with N times the batch.
// Processes synchronise only between the phases of a step.
#pragma once

#include "redrive/base/processes/process_group.h"
#include "redrive/train/step.h"

namespace redrive {

/// Computes the steps of a run in this process.
struct Rank {
  kernels::Backend& backend;
  /// Null, or the processes that compute each step together. All of them need the same state, and
  /// no error map.
  ProcessGroup* processes = nullptr;
};

/// Computes and applies a step. Returns means over the processes (opacity, errors, loss terms, pose
/// gradients) and sums of counts. A process that fails must end the others.
StepResult train_step(const Rank& rank, const TrainingSet& data, const StepRequest& request,
                      double learning_rate, TrainState* state, StepBuffers* buffers);

}  // namespace redrive
