// SPDX-License-Identifier: Apache-2.0
// The training loop: steps, schedule, restarts, roll-backs, pose refinement, progress, metrics,
// checkpoints, Ctrl-C.
#pragma once

#include <atomic>

#include "redrive/base/processes/process_group.h"
#include "redrive/kernels/backend.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"

namespace redrive {

/// Is called by train() between two steps, on its thread. Time in it is no time of training.
class StepObserver {
 public:
  virtual ~StepObserver() = default;
  /// `run` is the argument of train(), whose model may be used, not changed. Its scene has the pose
  /// corrections so far.
  virtual void between_steps(Run& run) = 0;
};

/// Returns the progress of a run, by the limit that will end it; 1 or more at its end.
/// `state.pixels`: not 0.
double run_progress(const TrainOptions& options, const TrainState& state);

enum class TrainEnd { kFinished, kInterrupted };

/// Trains from run->state.step to the end of the run, or until `stop`. A resumed run ends with the
/// same weights as an uninterrupted one, except with max_seconds and after a divergence, which
/// rolls back to the last checkpoint. The run's scene has the pose corrections while it trains, and
/// the recorded poses again afterwards.
TrainEnd train(Run* run, kernels::Backend& backend, const std::atomic<bool>& stop,
               StepObserver* observer = nullptr);
/// Trains likewise with loaded data. `processes`: null, or those that call this for the same run at
/// the same time (train/distributed/data_parallel.h); process 0 alone writes, and its clock counts.
/// Throws UsageError in each of them if they begin with different parameters.
TrainEnd train(Run* run, const TrainingData& data, kernels::Backend& backend,
               const std::atomic<bool>& stop, StepObserver* observer = nullptr,
               ProcessGroup* processes = nullptr);

}  // namespace redrive
