// SPDX-License-Identifier: Apache-2.0
// MLPs of --method grid with bf16 products and fp32 sums, for AVX-512 BF16; grid_kernels.h has them
// in fp32.
#pragma once

#include "redrive/kernels/cpu/simd/bf16_layout.h"
#include "redrive/kernels/grid/cpu/grid_kernels.h"

namespace redrive::kernels {

constexpr int kGridBf16Strip = 32;  ///< samples that pass through all layers together
constexpr int kGridBf16Block =
    8;  ///< outputs whose sums are kept in registers: 8 x 2 vectors of samples
constexpr int kGridBf16Rays = 16;  ///< maximum of rays per tile: one SIMD lane each

/// Weights of both MLPs. A matrix [outputs, inputs] is stored in blocks of eight outputs,
/// [outputs / 8][inputs / 2][8][2]; suffix _back: its transpose, colour_out's padded to four.
/// colour_out itself is a block of four outputs, the last all zeros.
struct GridBf16Weights {
  int width = 0, inputs = 0, colour_layers = 1;
  float density_scale = 1;
  const bf16::Bf16 *density0 = nullptr, *density1 = nullptr, *geometry = nullptr,
                   *harmonics = nullptr, *colour1 = nullptr, *colour_out = nullptr;
  const bf16::Bf16 *density0_back = nullptr, *density1_back = nullptr, *geometry_back = nullptr,
                   *colour1_back = nullptr, *colour_out_back = nullptr;
};

/// Rounds up to whole strips.
static constexpr int grid_bf16_samples(int samples) {
  return (samples + kGridBf16Strip - 1) / kGridBf16Strip * kGridBf16Strip;
}

/// Floats of scratch memory of a tile, forward and backward.
static constexpr std::size_t grid_bf16_scratch(int samples, int width, int inputs) {
  // Layers: features, six of `width`, geometry with harmonics, its gradient, the four of d_out.
  const std::size_t numbers =
      static_cast<std::size_t>(inputs) + 6 * static_cast<std::size_t>(width) + 3 * 16 + 4;
  const std::size_t n = static_cast<std::size_t>(grid_bf16_samples(samples));
  return numbers / 2 * kGridBf16Strip + numbers * n / 2 + 16 * static_cast<std::size_t>(width) + n +
         64;
}

/// As in GridKernels, for tiles of up to kGridBf16Rays rays.
struct GridBf16Kernels {
  void (*network_forward)(const GridBf16Weights& weights, const GridNetworkTile& tile, float* raw,
                          float* scratch);
  void (*network_backward)(const GridBf16Weights& weights, const GridNetworkTile& tile,
                           const float* d_raw, const GridNetworkGradients& gradients,
                           float* d_features, float* scratch);
};

namespace avx512_bf16 {
extern const GridBf16Kernels kGridBf16Kernels;
}

}  // namespace redrive::kernels
