// SPDX-License-Identifier: Apache-2.0
// Constants of the grid field that scalar functions and SIMD kernels share. No functions: files
// with instruction set flags may include this (kernels/cpu/simd/vector.h).
#pragma once

#include <cstdint>

namespace redrive {

constexpr int kHarmonics = 16;         ///< coefficients of spherical harmonics of degrees 0..3
constexpr int kGeometryFeatures = 16;  ///< outputs of the density MLP; the first is the log density

/// Larger log densities are clamped to this in the value only: the adjoint still lowers them.
constexpr float kMaxLogDensity = 15;

/// Primes of the hash of grid vertices (Mueller et al. 2022, eq. 4).
constexpr std::uint32_t kHashPrimeY = 2654435761u, kHashPrimeZ = 805459861u;

}  // namespace redrive
