// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/backend.h"

#include "redrive/kernels/image_score.h"

namespace redrive::kernels {

ImageScore Backend::score(const ImagePair& images) {
  ThreadPool one(1);
  return score_images(images, one);
}

}  // namespace redrive::kernels
