// SPDX-License-Identifier: Apache-2.0
// A GPU by the CUDA runtime, for nvcc alone: memory, copies and the kernels that run all functors.
// All work goes to the default stream, in order; copies to the host wait for the work before them.
// CUDA uses the current GPU of the calling thread, so functions that may run before begin() call
// use().
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>

#include <cuda_runtime.h>
#include <cub/device/device_scan.cuh>

#include "redrive/base/error.h"
#include "redrive/kernels/device/arena.h"
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/kernels/device/resident_buffers.h"

namespace redrive::kernels {

inline void check_cuda(cudaError_t error, const char* doing) {
  if (error != cudaSuccess)
    throw DeviceError(std::string("the GPU failed, ") + doing + ": " + cudaGetErrorString(error));
}

struct CudaAllocator {
  void* allocate(std::size_t bytes) const {
    void* memory = nullptr;
    const cudaError_t error = cudaMalloc(&memory, bytes);
    if (error == cudaErrorMemoryAllocation) {
      cudaGetLastError();  // clears the error
      throw DeviceMemoryError(
          "--backend", "cuda",
          "the GPU has no " + std::to_string(bytes >> 20) +
              " MiB left; lower --batch, use fewer or smaller images (--frames, --cameras, "
              "--downscale), or end other programs that use it");
    }
    check_cuda(error, "allocating");
    return memory;
  }
  void release(void* memory) const {
    cudaFree(memory);
  }  // the next copy reports errors of earlier work
};

/// Runs functor(i) in thread i, in a loop over grids.
template <class Functor>
__global__ void run_functor(std::size_t n, const Functor functor) {
  for (std::size_t i = blockIdx.x * std::size_t{blockDim.x} + threadIdx.x; i < n;
       i += std::size_t{gridDim.x} * blockDim.x)
    functor(i);
}

/// Runs functor(i) in warp i, in a loop over grids. All lanes have the same i, which __shfl_sync
/// shows to the compiler.
constexpr int kWarpsPerBlock = 4;
template <class Functor>
__global__ void __launch_bounds__(32 * kWarpsPerBlock)
    run_warp_functor(std::size_t n, const Functor functor) {
  const unsigned warp = __shfl_sync(0xFFFFFFFFu, threadIdx.x / 32, 0);
  for (std::size_t i = blockIdx.x * std::size_t{kWarpsPerBlock} + warp; i < n;
       i += std::size_t{gridDim.x} * kWarpsPerBlock) {
    functor(i);
    __syncwarp();  // lanes reconverge after divergent stores
  }
}

/// An empty kernel, to query the architecture that the code was compiled for.
template <class T>
__global__ void do_nothing(T) {}

class CudaDevice {
 public:
  /// A network of width 256 keeps 15 KB per sample (tensor_layers.h), 0.5 GB in all. A layer is
  /// 4096 warps, three times the number that an H200 runs at once.
  static constexpr std::size_t kMaxSamplesPerPass = std::size_t{1} << 15;
  /// 0.2 GB at width 64; one or two launches for a step's samples.
  static constexpr std::size_t kMaxGridSamplesPerPass = std::size_t{1} << 18;
  /// Four times the warps that an H100 runs at once. They copy 256 MiB, five times its cache.
  static constexpr std::size_t kBenchmarkWarps = std::size_t{1} << 17;

  explicit CudaDevice(int gpu) : gpu_(gpu) {
    use();
    check_cuda(cudaDeviceGetAttribute(&multiprocessors_, cudaDevAttrMultiProcessorCount, gpu),
               "querying the GPU");
    cudaFuncAttributes kernel{};
    check_cuda(cudaFuncGetAttributes(&kernel, do_nothing<int>), "querying the GPU");
    has_tensor_cores_ = kernel.ptxVersion >= 80;  // bf16 needs code for compute capability 8.0
  }
  int gpu() const { return gpu_; }
  /// Sets the calling thread's GPU; nearly free if it is set already.
  void use() const { check_cuda(cudaSetDevice(gpu_), "selecting a GPU"); }
  bool has_tensor_cores() const { return has_tensor_cores_; }
  std::optional<std::string> description() const { return cuda_description(gpu_); }
  std::optional<std::uint64_t> free_memory() const {
    use();
    std::size_t free = 0, all = 0;
    check_cuda(cudaMemGetInfo(&free, &all), "querying free memory");
    return free;
  }

  void begin() {
    use();
    memory_.begin();
  }
  void* take(std::size_t bytes) { return memory_.take(bytes); }
  std::shared_ptr<void> hold(std::size_t bytes) {
    use();
    return {CudaAllocator().allocate(bytes), [](void* memory) { CudaAllocator().release(memory); }};
  }
  void invalidate(std::span<std::byte>) {}
  void wait() {
    use();
    check_cuda(cudaDeviceSynchronize(), "computing");
  }
  void to_device(void* device, const void* host, std::size_t bytes) {
    use();
    check_cuda(cudaMemcpy(device, host, bytes, cudaMemcpyHostToDevice), "copying to the GPU");
  }
  void to_host(void* host, const void* device, std::size_t bytes) {
    use();
    check_cuda(cudaMemcpy(host, device, bytes, cudaMemcpyDeviceToHost), "computing");
  }
  void exclusive_sum(std::size_t n, const std::uint32_t* numbers, std::uint32_t* sums) {
    std::size_t bytes = 0;
    check_cuda(cub::DeviceScan::ExclusiveSum(nullptr, bytes, numbers, sums, n),
               "querying the size of a scan");
    check_cuda(cub::DeviceScan::ExclusiveSum(take(bytes), bytes, numbers, sums, n),
               "computing a prefix sum");
  }

  template <class Functor>
  void for_each(std::size_t n, const Functor& functor) {
    if (n == 0) return;
    constexpr std::size_t kThreads =
        128;  // smaller batches, such as rays, use single warps to occupy all multiprocessors
    const std::size_t threads = n < kThreads * multiprocessors_ ? 32 : kThreads;
    run_functor<<<blocks<Functor>(n, threads), static_cast<unsigned>(threads)>>>(n, functor);
    check_cuda(cudaGetLastError(), "starting a kernel");
  }
  template <class Functor>
  void for_each_warp(std::size_t n, const Functor& functor) {
    if (n == 0) return;
    run_warp_functor<<<blocks<Functor>(n, kWarpsPerBlock), 32 * kWarpsPerBlock>>>(n, functor);
    check_cuda(cudaGetLastError(), "starting a kernel");
  }

  ResidentBuffers resident;

 private:
  template <class Functor>
  unsigned blocks(std::size_t n, std::size_t each) const {
    static_assert(std::is_trivially_copyable_v<Functor>, "is copied to the GPU by bytes");
    static_assert(sizeof(Functor) <= 4000, "kernel arguments are limited to 4 KiB");
    constexpr std::size_t kBlocksEach = 64;  // per multiprocessor: enough to balance the load
    return static_cast<unsigned>(std::min((n + each - 1) / each, kBlocksEach * multiprocessors_));
  }

  int gpu_;
  int multiprocessors_ = 1;
  bool has_tensor_cores_ = false;
  Arena<CudaAllocator> memory_;
};

}  // namespace redrive::kernels
