// SPDX-License-Identifier: Apache-2.0
// Rows of Backend::score in vectors, compiled once per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "redrive/kernels/score_sums.h"
#include "redrive/optim/flip.h"
#include "redrive/optim/ssim.h"

namespace redrive::kernels {

/// Planes of an image: sRGB, black where masked, and FLIP's opponent colours.
static constexpr int kScorePlanes = 6;

struct ScoreJob {
  int width = 0, height = 0;
  std::size_t stride = 0;  ///< width, padded to a multiple of 16
  // ImagePair; mask may be null.
  const float* rgb = nullptr;
  const std::uint8_t *ground_truth = nullptr, *mask = nullptr;
  float* planes = nullptr;  ///< [2, kScorePlanes, height, stride]: image, ground truth
  const FlipFilters* flip = nullptr;
  float taps[kSsimTaps] = {};  ///< ssim_taps()
};

/// Floats of scratch memory of score_row: rows with room beside them.
static constexpr std::size_t kScoreRoom = 32, kScoreRows = 16;
static constexpr std::size_t score_scratch(std::size_t stride) {
  return kScoreRows * (stride + 2 * kScoreRoom);
}

struct ScoreKernels {
  /// Writes a row of the planes, and adds its squared errors and pixels.
  void (*fill_row)(const ScoreJob& job, int y, ScoreSums* sums);
  /// Adds a row's SSIM and FLIP, once all rows are filled.
  void (*score_row)(const ScoreJob& job, int y, float* scratch, ScoreSums* sums);
};

namespace avx2 {
extern const ScoreKernels kScoreKernels;
}
namespace avx512 {
extern const ScoreKernels kScoreKernels;
}

}  // namespace redrive::kernels
