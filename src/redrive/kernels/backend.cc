// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/backend.h"

#include "redrive/kernels/image_score.h"

namespace redrive::kernels {

ImageScore Backend::score(const ImagePair& images) { return score_images(images, pool_); }

}  // namespace redrive::kernels
