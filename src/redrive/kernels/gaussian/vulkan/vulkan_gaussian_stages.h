// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "redrive/base/parallel.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/vulkan/vulkan_queue.h"

namespace redrive::kernels {

/// Both must outlive the stages.
std::unique_ptr<GaussianStages> make_vulkan_gaussian_stages(vulkan::Queue* queue, ThreadPool* pool);

}  // namespace redrive::kernels
