// SPDX-License-Identifier: Apache-2.0
// --backend cuda, as the rest of the program sees it: no CUDA type. Without nvcc at build time:
// no_cuda.cc.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "redrive/kernels/backend_group.h"

namespace redrive::kernels {

/// GPUs that CUDA_VISIBLE_DEVICES shows; they have numbers from 0 on. 0: cuda_obstacle says why.
int cuda_gpus();

/// Why there is no cuda backend here: not in this build, no driver, no GPU, that one too old.
/// Nothing if there is one.
std::optional<std::string> cuda_obstacle(int gpu = 0);

/// "NVIDIA H200, compute capability 9.0, 139.8 GiB, driver for CUDA 13.0". There must be no
/// obstacle.
std::string cuda_description(int gpu = 0);

/// There must be no obstacle. threads: the host's. What a GPU says no to later is a
/// DeviceMemoryError where it has none left, else a DeviceError with CUDA's words. Any thread may
/// use it, one at a time. Without tensor cores networks are fp32, for tests.
std::unique_ptr<Backend> make_cuda_backend(int threads, bool tensor_cores = true, int gpu = 0);

/// Of such backends, which outlive it, each on a GPU of its own. There must be no nccl_obstacle
/// (nccl.h). DeviceError.
std::unique_ptr<AllReduce> make_nccl_all_reduce(std::span<const std::unique_ptr<Backend>> backends);

/// Bytes that went there and back, how often the host waited for such, and how many were taken of
/// its memory at most.
struct TransferCounts {
  std::size_t to_device = 0, to_host = 0, waits = 0, peak_bytes = 0;
};
/// What is to go wrong.
struct InjectedFaults {
  std::optional<std::uint64_t> free_memory;  ///< that it says it has
  std::int64_t works =
      -1;  ///< so many kernels more, then everything is a DeviceError; negative: always
  std::int64_t places =
      -1;  ///< so many pieces of memory more, then DeviceMemoryError; negative: always
  bool skips_first_warp = false;  ///< the first of every kernel
};
/// The same stages and functors in plain loops on the host (loop_device.h): for tests. Counts
/// copies unless `copies` is null.
std::unique_ptr<Backend> make_loop_backend(TransferCounts* copies = nullptr,
                                           bool tensor_cores = true,
                                           InjectedFaults* faults = nullptr);

}  // namespace redrive::kernels
