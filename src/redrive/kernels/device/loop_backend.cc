// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/device/cuda_backend.h"
#include "redrive/kernels/device/device_backend.h"
#include "redrive/kernels/device/loop_device.h"

namespace redrive::kernels {

std::unique_ptr<Backend> make_loop_backend(TransferCounts* copies, bool tensor_cores,
                                           InjectedFaults* faults) {
  if (tensor_cores) return std::make_unique<DeviceBackend<LoopDevice>>("loop", 1, copies, faults);
  return std::make_unique<DeviceBackend<WithoutTensorCores<LoopDevice>>>("loop", 1, copies, faults);
}

}  // namespace redrive::kernels
