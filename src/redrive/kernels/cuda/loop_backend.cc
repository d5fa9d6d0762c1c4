// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/cuda/cuda_backend.h"
#include "redrive/kernels/cuda/device_backend.h"
#include "redrive/kernels/cuda/loop_device.h"

namespace redrive::kernels {

std::unique_ptr<Backend> make_loop_backend(DeviceCopies* copies, bool tensor_cores,
                                           LoopTroubles* troubles) {
  if (tensor_cores) return std::make_unique<DeviceBackend<LoopDevice>>("loop", 1, copies, troubles);
  return std::make_unique<DeviceBackend<WithoutTensorCores<LoopDevice>>>("loop", 1, copies,
                                                                         troubles);
}

}  // namespace redrive::kernels
