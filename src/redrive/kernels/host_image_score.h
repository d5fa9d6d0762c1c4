// SPDX-License-Identifier: Apache-2.0
// Backend::score of the backends on the host.
#pragma once

#include "redrive/base/parallel.h"
#include "redrive/kernels/backend.h"

namespace redrive::kernels {

/// The pixels are shared among threads, sums go over all of them in order: the threads change no
/// bit.
ImageScore score_on_host(const ImagePair& pictures, ThreadPool& pool);

}  // namespace redrive::kernels
