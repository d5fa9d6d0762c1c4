// SPDX-License-Identifier: Apache-2.0
// Backend::score by the scalar functions of optim/ssim.h and optim/flip.h, in double, and what
// backends share.
#pragma once

#include "redrive/kernels/backend.h"
#include "redrive/kernels/score_sums.h"

namespace redrive::kernels {

/// Returns the scores of an image whose parts have these sums.
ImageScore score_from_sums(std::span<const ScoreSums> parts);

void check_image_pair(const ImagePair& images);

/// In one thread.
ImageScore score_images(const ImagePair& images);

}  // namespace redrive::kernels
