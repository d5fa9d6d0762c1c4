// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/cpu/bf16/engine_amx.h"
#include "redrive/kernels/cpu/bf16/network_stages.h"
#include "redrive/kernels/cpu/bf16/tiles_emulated.h"

namespace redrive::kernels::bf16 {

const Stages& amx_emulated_stages() { return NetworkStages<AmxEngine<EmulatedTiles>>::kStages; }

}  // namespace redrive::kernels::bf16
