// SPDX-License-Identifier: Apache-2.0
// --backend cuda for the rest of the program, without CUDA types. Builds without nvcc use
// no_cuda.cc.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "redrive/kernels/backend_group.h"

namespace redrive::kernels {

/// Returns the number of GPUs that CUDA_VISIBLE_DEVICES shows, numbered from 0. If there is none,
/// cuda_obstacle returns why.
int cuda_gpus();

/// Returns why there is no cuda backend (not in this build, no driver, no GPU, too old a GPU), or
/// nothing if there is one.
std::optional<std::string> cuda_obstacle(int gpu = 0);

/// Returns "NVIDIA H200, compute capability 9.0, 139.8 GiB, driver for CUDA 13.0". There must be no
/// obstacle.
std::string cuda_description(int gpu = 0);

/// Returns the backend of a GPU; there must be no obstacle. threads: number of threads on the host.
/// Stages throw DeviceMemoryError if the GPU has no memory left, else DeviceError with CUDA's
/// message. Any thread may use the backend, one at a time. Without tensor_cores networks are fp32,
/// for tests.
std::unique_ptr<Backend> make_cuda_backend(int threads, bool tensor_cores = true, int gpu = 0);

/// Returns the all-reduce of cuda backends on different GPUs. The backends must outlive it. There
/// must be no nccl_obstacle (nccl.h). DeviceError: NCCL failed.
std::unique_ptr<AllReduce> make_nccl_all_reduce(std::span<const std::unique_ptr<Backend>> backends);

/// Counts bytes copied to and from the device, copies that the host waited for, and the peak of
/// device memory.
struct TransferCounts {
  std::size_t to_device = 0, to_host = 0, waits = 0, peak_bytes = 0;
};
/// Failures of the loop backend, for tests.
struct InjectedFaults {
  std::optional<std::uint64_t> free_memory;  ///< bytes that it reports as free
  /// Kernels to run before everything throws DeviceError; negative: no limit.
  std::int64_t kernel_launches = -1;
  /// Allocations that succeed before DeviceMemoryError; negative: no limit.
  std::int64_t allocations = -1;
  bool skips_first_warp = false;  ///< in every kernel
};
/// Returns a backend that runs the same stages and functors in loops on the host (loop_device.h),
/// for tests. copies, faults: may be null.
std::unique_ptr<Backend> make_loop_backend(TransferCounts* copies = nullptr,
                                           bool tensor_cores = true,
                                           InjectedFaults* faults = nullptr);

}  // namespace redrive::kernels
