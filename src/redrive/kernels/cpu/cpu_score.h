// SPDX-License-Identifier: Apache-2.0
// Backend::score in vectors.
#pragma once

#include "redrive/base/buffer.h"
#include "redrive/base/parallel.h"
#include "redrive/kernels/cpu/score_kernels.h"
#include "redrive/kernels/image_score.h"

namespace redrive::kernels {

/// Keeps its memory from image to image.
class CpuScore {
 public:
  CpuScore(Isa isa, ThreadPool* pool);

  /// Sums rows in order, so that the number of threads changes no bit.
  ImageScore score(const ImagePair& images);

 private:
  const ScoreKernels& kernels_;
  ThreadPool& pool_;
  const FlipFilters filters_ = flip_filters();
  Buffer<float> planes_;
};

}  // namespace redrive::kernels
