// SPDX-License-Identifier: Apache-2.0
// Means over GPUs by NCCL, for nvcc alone. One thread starts the operation on all GPUs and waits
// for all of them together, so that none waits for a GPU that failed.
#pragma once

#include <string>
#include <vector>

#include "redrive/kernels/backend_group.h"
#include "redrive/kernels/device/cuda_device.h"
#include "redrive/kernels/device/nccl.h"

namespace redrive::kernels {

class NcclAllReduce final : public AllReduce {
 public:
  /// devices: one per GPU; they must outlive this object.
  explicit NcclAllReduce(std::vector<CudaDevice*> devices)
      : devices_(std::move(devices)), comms_(devices_.size()), streams_(devices_.size()) {
    std::vector<int> gpus;
    for (const CudaDevice* device : devices_) gpus.push_back(device->gpu());
    if (const int result =
            nccl().ncclCommInitAll(comms_.data(), static_cast<int>(gpus.size()), gpus.data()))
      throw DeviceError(words(result));
    for (std::size_t r = 0; r < devices_.size(); ++r) {
      devices_[r]->use();
      // These streams synchronise with the default stream.
      check_cuda(cudaStreamCreate(&streams_[r]), "creating a stream");
    }
  }
  ~NcclAllReduce() override {
    abort();
    for (std::size_t r = 0; r < devices_.size(); ++r)
      if (streams_[r]) cudaStreamDestroy(streams_[r]);
  }
  NcclAllReduce(const NcclAllReduce&) = delete;
  NcclAllReduce& operator=(const NcclAllReduce&) = delete;

  void mean(std::span<const std::span<float>> parts) override {
    REDRIVE_CHECK_OP(parts.size(), ==, devices_.size());
    std::vector<void*> arrays;
    for (std::size_t r = 0; r < parts.size(); ++r) {
      REDRIVE_CHECK_OP(parts[r].size(), ==, parts[0].size());
      arrays.push_back(devices_[r]->resident.find(std::as_bytes(parts[r])));
      REDRIVE_CHECK(arrays.back() != nullptr);
    }
    int result = nccl().ncclGroupStart();
    for (std::size_t r = 0; r < parts.size() && result == Nccl::kSuccess; ++r)
      result = nccl().ncclAllReduce(arrays[r], arrays[r], parts[r].size(), Nccl::kFloat32,
                                    Nccl::kAvg, comms_[r], streams_[r]);
    const int ended = nccl().ncclGroupEnd();
    if (result == Nccl::kSuccess) result = ended;
    if (result != Nccl::kSuccess) fail(words(result));
    while (!all_done()) {
    }
    cudaGetLastError();  // cudaErrorNotReady is no failure; clears it
  }

 private:
  static std::string words(int result) {
    return std::string("NCCL failed, averaging gradients: ") + nccl().ncclGetErrorString(result);
  }

  bool all_done() {
    bool all = true;
    for (std::size_t r = 0; r < devices_.size(); ++r) {
      devices_[r]->use();
      const cudaError_t state = cudaStreamQuery(streams_[r]);
      if (state != cudaSuccess && state != cudaErrorNotReady)
        fail("GPU " + std::to_string(r) +
             ": the GPU failed, averaging gradients: " + cudaGetErrorString(state));
      int result = Nccl::kSuccess;
      const int asked = nccl().ncclCommGetAsyncError(comms_[r], &result);
      for (const int failure : {asked, result})
        if (failure != Nccl::kSuccess && failure != Nccl::kInProgress) fail(words(failure));
      all = all && state == cudaSuccess;
    }
    return all;
  }

  [[noreturn]] void fail(const std::string& what) {
    abort();
    throw DeviceError(what);
  }
  /// Ends operations that still wait for other ranks.
  void abort() {
    for (void*& comm : comms_)
      if (comm) nccl().ncclCommAbort(std::exchange(comm, nullptr));
  }

  std::vector<CudaDevice*> devices_;
  std::vector<void*> comms_;
  std::vector<cudaStream_t> streams_;
};

}  // namespace redrive::kernels
