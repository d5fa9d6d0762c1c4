// SPDX-License-Identifier: Apache-2.0
// Data parallelism: several backends make every step together. Each rank has a copy of what is
// trained and draws its own part of the step; an all-reduce gives all ranks the mean of the
// gradients, and each updates its copy alike. A step of N ranks is one backend's with N times the
// batch. Ranks wait for each other only between the parts of a step, so that one that fails ends
// the step.
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/kernels/backend_group.h"
#include "redrive/train/step.h"

namespace redrive {

struct Rank {
  kernels::Backend& backend;
  int rank = 0;
  TrainState* state = nullptr;  ///< rank 0: the run's; others: `copy`
  TrainState copy = {};         ///< of what steps change
  StepBuffers buffers = {};
  StepResult result = {};  ///< of its own part of the last step
};

class DataParallelGroup {
 public:
  /// Backends and `state` outlive it. all_reduce: may be null for one backend.
  DataParallelGroup(const std::vector<kernels::Backend*>& backends, kernels::AllReduce* all_reduce,
                    TrainState* state);

  int size() const { return static_cast<int>(ranks_.size()); }
  Rank& first() { return *ranks_.front(); }
  const Rank& operator[](int rank) const { return *ranks_[rank]; }

  /// Copies the state of rank 0 to the others. Call before the first step, and when that state has
  /// been replaced. No backend keeps any of it on a device yet.
  void begin();

  /// One training step of all ranks. `request` for rank 0; the others' follow from it. Returns
  /// means over the ranks (opacity, errors, loss terms, pose gradients) and sums of counts.
  /// DeviceError and DeviceMemoryError name the rank that failed.
  StepResult step(const TrainingSet& data, const StepRequest& request, double learning_rate);

 private:
  void each(const std::function<void(Rank&)>& work);

  ThreadPool pool_;
  std::vector<std::unique_ptr<Rank>> ranks_;
  kernels::AllReduce* all_reduce_;
  // Error map updates of all ranks, where there are several:
  std::vector<std::uint32_t> cells_;
  std::vector<float> squared_errors_;
};

}  // namespace redrive
