// SPDX-License-Identifier: Apache-2.0
// Backends that make every step together: each has a copy of what is trained and a share of the
// rays, the mean of their gradients goes to all, and each changes its copy alike. So a step of N of
// them is one backend's with N times the rays. Nobody waits for another but between the parts of a
// step, so that one that fails ends the step and not the others' patience.
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/kernels/backend_group.h"
#include "redrive/train/pose_refiner.h"
#include "redrive/train/step.h"

namespace redrive {

struct Rank {
  kernels::Backend& backend;
  Share share;
  TrainState* state;  ///< the first one's is the run's, the others' `copy`
  TrainState copy;    ///< of what steps change
  RayBatch batch, lidar;
  StepBuffers buffers;
  StepResult result;  ///< of its own rays in the last step
};

class DataParallelGroup {
 public:
  /// They and `state` outlive it. reduction: may be null of one backend.
  DataParallelGroup(const std::vector<kernels::Backend*>& backends, kernels::AllReduce* reduction,
                    TrainState* state);

  int size() const { return static_cast<int>(members_.size()); }
  Rank& first() { return *members_.front(); }
  const Rank& operator[](int rank) const { return *members_[rank]; }

  /// Before the first step, and when the first one's state is another: all go on from that. Nobody
  /// keeps any of it elsewhere yet.
  void begin();

  /// train_step of the rays that `gather` puts into each member's batches, called by several
  /// threads. What it returns is of all of them: means (of LossTerms only opacity, rgb_mse, colours
  /// and range), counts in sum, no derivatives of rays. DeviceError and DeviceMemoryError say which
  /// member it was.
  StepResult step(const std::function<void(Rank&)>& gather, double learning_rate);

  /// Of the last step, whose batches refine: pose_refiner.h, of all its rays.
  std::vector<ViewGradient> view_gradients(const Scene& scene) const;

 private:
  void each(const std::function<void(Rank&)>& work);

  ThreadPool pool_;
  std::vector<std::unique_ptr<Rank>> members_;
  kernels::AllReduce* reduction_;
  // Of all rays of a step, where there are several members:
  std::vector<std::uint32_t> cells_;
  std::vector<float> squares_;
};

}  // namespace redrive
