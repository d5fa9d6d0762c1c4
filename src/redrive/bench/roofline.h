// SPDX-License-Identifier: Apache-2.0
// What a training step of Gaussians moves and computes by stage, and the time that GPUs would take:
// estimates, from counts of the benchmarks' street.
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
/// The first one is measured (docs/gpu.md), the others are estimated. Sources: NVIDIA's data sheet
/// of the H200, its white papers of the Ada and of the Ampere GA102 architecture; Intel's data of
/// the Core i9-12900 (32 units of 8 lanes at 1.55 GHz; DDR5-4800 in two channels).
constexpr Gpu kGpus[] = {
    {"H200", 67, 4800}, {"RTX 4090", 82.6, 1008}, {"RTX 3060", 12.7, 360}, {"UHD 770", 0.79, 76.8}};

struct StageCost {
  std::string stage;
  double flops, bytes;
  double h200_ms;  ///< measured in the step of 400,000 Gaussians on 640 x 352 pixels

  double least_ms(const Gpu& gpu) const;
  /// As much longer than the least time as the H200 took, by its costs in that step.
  double estimated_ms(const Gpu& gpu, const StageCost& measured) const;
};

struct StepCounts {
  double gaussians, drawn, pairs, pixels;
};
std::vector<StageCost> step_costs(const StepCounts& counts);

struct StepCost {
  int width, height;
  StepCounts counts;
  std::vector<StageCost> stages;
};
/// Steps of 400,000 Gaussians on 640 x 352 and on 1280 x 704 pixels. The backend counts.
std::vector<StepCost> count_steps(kernels::Backend& backend);

}  // namespace redrive::bench
