// SPDX-License-Identifier: Apache-2.0
// The Gaussians of a divided run as one set.
#pragma once

#include "redrive/base/buffer.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {

class DividedModel;

struct MergedGaussians {
  std::size_t n = 0;
  Buffer<float> numbers;

  kernels::Gaussians gaussians() const { return {n, numbers.span()}; }
};

/// Returns from each block the Gaussians whose nearest place on the way is in the block's core, so
/// that what several blocks hold comes once. Colours are multiplied by the block's mean log gains
/// (train/files/seam_exposure.h). Loads one block after the other. The model's method must be
/// splat.
MergedGaussians merged_gaussians(const DividedModel& model);

}  // namespace redrive
