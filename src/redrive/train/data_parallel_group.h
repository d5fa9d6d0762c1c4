// SPDX-License-Identifier: Apache-2.0
// Data parallelism: several backends, of one process or of several processes with one each, compute
// every step together. Each rank has a replica of the
// state and draws its own batch; an all-reduce averages the gradients, and each rank applies the
// same update. A step of N ranks equals one of a single backend with N times the batch. Ranks
// synchronise only between the phases of a step, so that a failing rank ends the step.
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/base/process_group.h"
#include "redrive/kernels/backend_group.h"
#include "redrive/train/step.h"

namespace redrive {

struct Rank {
  kernels::Backend& backend;
  int rank = 0;
  TrainState* state = nullptr;  ///< rank 0: the run's; others: `copy`
  TrainState copy = {};         ///< replica of the state
  StepBuffers buffers = {};
  StepResult result = {};  ///< of this rank's batch in the last step
};

class DataParallelGroup {
 public:
  /// Backends, `state` and processes must outlive it. all_reduce: may be null for one backend.
  /// `processes`: null, or those that compute steps together, each with one backend in the host's
  /// memory, the same state, and no error map.
  DataParallelGroup(const std::vector<kernels::Backend*>& backends, kernels::AllReduce* all_reduce,
                    TrainState* state, ProcessGroup* processes = nullptr);

  int size() const {
    return static_cast<int>(ranks_.size()) * (processes_ ? processes_->size() : 1);
  }
  Rank& first() { return *ranks_.front(); }
  const Rank& operator[](int rank) const { return *ranks_[rank]; }

  /// Copies the state of rank 0 to the others. Call before the first step, and after that state was
  /// replaced. No backend may hold the state on a device yet.
  void begin();

  /// Runs one training step on all ranks. `request`: of rank 0; the others' are derived from it.
  /// Returns means over the ranks (opacity, errors, loss terms, pose gradients) and sums of counts.
  /// Throws DeviceError and DeviceMemoryError, which name the rank that failed. With processes, a
  /// rank that fails has to end the others.
  StepResult step(const TrainingSet& data, const StepRequest& request, double learning_rate);

 private:
  void each(const std::function<void(Rank&)>& work);
  /// Returns the results of all processes as one, and averages their gradients.
  StepResult reduce_over_processes();

  ThreadPool pool_;
  std::vector<std::unique_ptr<Rank>> ranks_;
  kernels::AllReduce* all_reduce_;
  ProcessGroup* processes_;
  // Concatenated error map updates of several ranks.
  std::vector<std::uint32_t> cells_;
  std::vector<float> squared_errors_;
};

}  // namespace redrive
