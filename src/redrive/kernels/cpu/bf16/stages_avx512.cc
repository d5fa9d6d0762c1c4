// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/cpu/bf16/engine_avx512.h"
#include "redrive/kernels/cpu/bf16/network_stages.h"

namespace redrive::kernels::bf16 {

const Stages& avx512_stages() { return NetworkStages<Avx512Engine>::kStages; }

}  // namespace redrive::kernels::bf16
