// SPDX-License-Identifier: Apache-2.0
// The compiled shaders, which the build embeds (cmake/shaders.cmake).
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

namespace redrive::kernels {

struct Shader {
  std::string_view name;                 ///< as CMakeLists.txt calls it
  std::span<const std::uint32_t> words;  ///< SPIR-V for Vulkan 1.2
};
std::span<const Shader> gaussian_shaders();

}  // namespace redrive::kernels
