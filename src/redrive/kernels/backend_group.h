// SPDX-License-Identifier: Apache-2.0
// Several GPUs of one machine, each with its share of every training step
// (train/data_parallel_group.h).
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "redrive/kernels/backend.h"

namespace redrive::kernels {

/// What makes one of what several backends have computed.
class AllReduce {
 public:
  virtual ~AllReduce() = default;
  /// parts[r]: numbers that backend r keeps, as many as the others. Each of them becomes their
  /// mean, the same bits on all backends. DeviceError: one of them failed, and nobody waits for it.
  virtual void mean(std::span<const std::span<float>> parts) = 0;
};

/// The first backend is the one for what a run does once.
struct BackendGroup {
  std::vector<std::unique_ptr<Backend>> backends;
  std::unique_ptr<AllReduce> reduction;  ///< none of one backend
};

/// --gpus, beside what chooses one backend; 1: make_backend. UsageError says why there are not so
/// many, or that there is no NCCL.
BackendGroup make_backend_group(const BackendChoice& choice, int gpus);

}  // namespace redrive::kernels
