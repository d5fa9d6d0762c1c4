// SPDX-License-Identifier: Apache-2.0
// The compiled shaders, which the build embeds (cmake/shaders.cmake).
#pragma once

#include <span>

#include "redrive/kernels/vulkan/shader.h"

namespace redrive::kernels {

std::span<const vulkan::Shader> gaussian_shaders();

}  // namespace redrive::kernels
