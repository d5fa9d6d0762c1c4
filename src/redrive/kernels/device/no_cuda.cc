// SPDX-License-Identifier: Apache-2.0
// Replaces cuda_backend.cu in builds without nvcc.
#include "redrive/base/error.h"
#include "redrive/kernels/device/cuda_backend.h"

namespace redrive::kernels {

int cuda_gpus() { return 0; }

std::optional<std::string> cuda_obstacle(int) { return "not in this build"; }

std::string cuda_description(int) {
  check_failed(__FILE__, __LINE__, "cuda_description", *cuda_obstacle());
}

std::unique_ptr<Backend> make_cuda_backend(int, bool, int) {
  check_failed(__FILE__, __LINE__, "make_cuda_backend", *cuda_obstacle());
}

std::unique_ptr<AllReduce> make_nccl_all_reduce(std::span<const std::unique_ptr<Backend>>) {
  check_failed(__FILE__, __LINE__, "make_nccl_reduction", *cuda_obstacle());
}

}  // namespace redrive::kernels
