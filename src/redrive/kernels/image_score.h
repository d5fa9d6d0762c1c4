// SPDX-License-Identifier: Apache-2.0
// Backend::score by the scalar functions of optim/ssim.h and optim/flip.h.
#pragma once

#include "redrive/base/parallel.h"
#include "redrive/kernels/backend.h"

namespace redrive::kernels {

/// Distributes the pixels among the threads and sums over all of them in order, so that the number
/// of threads changes no bit.
ImageScore score_images(const ImagePair& images, ThreadPool& pool);

}  // namespace redrive::kernels
