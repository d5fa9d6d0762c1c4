// SPDX-License-Identifier: Apache-2.0
// Backends of several GPUs of one machine. Each computes its part of every training step
// (train/data_parallel_group.h).
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "redrive/kernels/backend.h"

namespace redrive::kernels {

/// Averages arrays over several backends.
class AllReduce {
 public:
  virtual ~AllReduce() = default;
  /// Replaces each number of parts[r], resident on backend r and of the same size on all, by its
  /// mean over the backends, with the same bits on all of them. DeviceError: a backend failed; the
  /// others do not wait for it.
  virtual void mean(std::span<const std::span<float>> parts) = 0;
};

/// The first backend also runs the stages that are needed once per run.
struct BackendGroup {
  std::vector<std::unique_ptr<Backend>> backends;
  std::unique_ptr<AllReduce> reduction;  ///< null for one backend
};

/// Returns backends on `gpus` GPUs (--gpus), for 1 that of make_backend. UsageError: fewer usable
/// GPUs, or no NCCL.
BackendGroup make_backend_group(const BackendChoice& choice, int gpus);

}  // namespace redrive::kernels
