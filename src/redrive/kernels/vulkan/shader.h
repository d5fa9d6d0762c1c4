// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

namespace redrive::kernels::vulkan {

/// A compiled shader.
struct Shader {
  std::string_view name;
  std::span<const std::uint32_t> words;  ///< SPIR-V for Vulkan 1.2
};

}  // namespace redrive::kernels::vulkan
