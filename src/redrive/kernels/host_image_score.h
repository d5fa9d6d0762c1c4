// SPDX-License-Identifier: Apache-2.0
// Backend::score of the backends on the host.
#pragma once

#include "redrive/base/parallel.h"
#include "redrive/kernels/backend.h"

namespace redrive::kernels {

/// Distributes the pixels among the threads and sums over all of them in order, so that the number
/// of threads changes no bit.
ImageScore score_on_host(const ImagePair& images, ThreadPool& pool);

}  // namespace redrive::kernels
