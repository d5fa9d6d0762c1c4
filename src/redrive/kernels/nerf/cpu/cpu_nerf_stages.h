// SPDX-License-Identifier: Apache-2.0
// The stages of --method nerf of the cpu backend.
#pragma once

#include <memory>

#include "redrive/base/cpu_features.h"
#include "redrive/base/parallel.h"
#include "redrive/kernels/cpu/cpu_kernels.h"
#include "redrive/kernels/nerf/nerf_stages.h"

namespace redrive::kernels {

/// `backend` owns the stages, its kernels and its pool.
std::unique_ptr<NerfStages> make_cpu_nerf_stages(Backend& backend, Isa isa,
                                                 const CpuKernels& kernels, ThreadPool* pool);

}  // namespace redrive::kernels
