// SPDX-License-Identifier: Apache-2.0
// In place of cuda_backend.cu where there was no nvcc.
#include "redrive/base/error.h"
#include "redrive/kernels/cuda/cuda_backend.h"

namespace redrive::kernels {

std::optional<std::string> cuda_obstacle() { return "not in this build"; }

std::string cuda_description() { check_failed(__FILE__, __LINE__, "cuda_description", *cuda_obstacle()); }

std::unique_ptr<Backend> make_cuda_backend(int, bool) {
  check_failed(__FILE__, __LINE__, "make_cuda_backend", *cuda_obstacle());
}

}  // namespace redrive::kernels
