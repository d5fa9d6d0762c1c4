// SPDX-License-Identifier: Apache-2.0
// Roofline estimates of a training step of Gaussians: bytes and arithmetic of each stage, counted
// on the benchmarks' street, and the time that they take GPUs.
#pragma once

#include <string>
#include <vector>

#include "redrive/kernels/backend.h"

namespace redrive::bench {

/// Published peaks.
struct Gpu {
  const char* name;
  double tflops;    ///< in 32 bits, a multiply-add counts as two
  double gb_per_s;  ///< bandwidth of the GPU's memory
};
/// The first one is measured (docs/gpu.md), the others are estimated. Sources: NVIDIA's H200
/// data sheet, its Ada and Ampere GA102 white papers; Intel's Core i9-12900 data (32 units of 8
/// lanes at 1.55 GHz; DDR5-4800 in two channels).
constexpr Gpu kGpus[] = {
    {"H200", 67, 4800}, {"RTX 4090", 82.6, 1008}, {"RTX 3060", 12.7, 360}, {"UHD 770", 0.79, 76.8}};

/// Operations of a Gaussian's projection and of its adjoint by camera model opencv_pinhole, as the
/// shaders have them.
constexpr double kProjectOperations = 540, kAdjointOperations = 1270;

struct StageCost {
  std::string stage;
  double flops, bytes;
  double h200_ms;  ///< measured in the step of 400,000 Gaussians on 640 x 352 pixels

  /// Returns the time that the peaks allow.
  double least_ms(const Gpu& gpu) const;
  /// Returns the least time, lengthened by the factor that the H200 took in the `measured` stage.
  double estimated_ms(const Gpu& gpu, const StageCost& measured) const;
};

struct StepCounts {
  double gaussians, drawn, pairs, pixels;
};
/// Returns the stages in the order of a step.
std::vector<StageCost> step_costs(const StepCounts& counts);

struct StepCost {
  int width, height;
  StepCounts counts;
  std::vector<StageCost> stages;
};
/// Steps of 400,000 Gaussians on 640 x 352 and on 1280 x 704 pixels. The backend counts.
std::vector<StepCost> count_steps(kernels::Backend& backend);

}  // namespace redrive::bench
