// SPDX-License-Identifier: Apache-2.0
// The loop: batches, schedule, watch for dead or diverging starts and for divergence after them,
// progress, metrics, checkpoints, Ctrl-C.
#pragma once

#include <atomic>

#include "redrive/kernels/backend_group.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"

namespace redrive {

enum class TrainEnd { kFinished, kInterrupted };

/// Trains `run->state` on to its end (or until *stop). Starts from state.step, so that it also
/// resumes: a resumed run ends with the same weights as an uninterrupted one (max_seconds apart),
/// metrics.jsonl is cut back to the checkpoint first. A divergence goes back to the last
/// checkpoint, and when that was written may depend on the clock and on Ctrl-C, too.
TrainEnd train(Run* run, kernels::Backend& backend, const std::atomic<bool>& stop);
/// The same with the pictures of run->scene.views already loaded (train/training_data.h), by
/// backends that make each step together (train/data_parallel_group.h); one needs no reduction.
TrainEnd train(Run* run, const TrainingData& data, const std::vector<kernels::Backend*>& backends,
               kernels::AllReduce* reduction, const std::atomic<bool>& stop);

}  // namespace redrive
