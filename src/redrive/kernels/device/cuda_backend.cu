// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/device/cuda_backend.h"

#include <cstdio>

#include "redrive/kernels/device/cuda_device.h"
#include "redrive/kernels/device/device_backend.h"
#include "redrive/kernels/device/nccl_all_reduce.h"

namespace redrive::kernels {
namespace {

constexpr int kMinMajor = 7, kMinMinor = 5;  // the oldest architecture in CMakeLists.txt

std::string cuda_version(int version) {  // 13000 is 13.0
  return std::to_string(version / 1000) + "." + std::to_string(version % 1000 / 10);
}

int driver_version() {
  int version = 0;
  return cudaDriverGetVersion(&version) == cudaSuccess ? version : 0;
}

cudaDeviceProp properties_of(int gpu) {
  cudaDeviceProp device;
  check_cuda(cudaGetDeviceProperties(&device, gpu), "querying the GPU");
  return device;
}

}  // namespace

int cuda_gpus() {
  int gpus = 0;
  const cudaError_t error = cudaGetDeviceCount(&gpus);
  cudaGetLastError();  // clears the error
  return error == cudaSuccess ? gpus : 0;
}

std::optional<std::string> cuda_obstacle(int gpu) {
  const int driver = driver_version();
  if (driver == 0) return "no NVIDIA driver";
  int devices = 0;
  const cudaError_t error = cudaGetDeviceCount(&devices);
  cudaGetLastError();  // clears the error
  if (error == cudaErrorInsufficientDriver)
    return "the NVIDIA driver is for CUDA " + cuda_version(driver) +
           " and older; this build needs " + cuda_version(CUDART_VERSION);
  if (error == cudaErrorNoDevice || (error == cudaSuccess && devices == 0)) return "no NVIDIA GPU";
  if (error != cudaSuccess) return std::string("CUDA reports: ") + cudaGetErrorString(error);
  cudaDeviceProp device;
  if (const cudaError_t asked = cudaGetDeviceProperties(&device, gpu); asked != cudaSuccess) {
    cudaGetLastError();
    return std::string("CUDA reports: ") + cudaGetErrorString(asked);
  }
  if (device.major < kMinMajor || (device.major == kMinMajor && device.minor < kMinMinor))
    return std::string(device.name) + " has compute capability " + std::to_string(device.major) +
           "." + std::to_string(device.minor) + ", at least 7.5 is required";
  return std::nullopt;
}

std::string cuda_description(int gpu) {
  const cudaDeviceProp device = properties_of(gpu);
  char memory[32];
  std::snprintf(memory, sizeof memory, "%.1f GiB",
                0x1p-30 * static_cast<double>(device.totalGlobalMem));
  return std::string(device.name) + ", compute capability " + std::to_string(device.major) + "." +
         std::to_string(device.minor) + ", " + memory + ", driver for CUDA " +
         cuda_version(driver_version());
}

std::unique_ptr<Backend> make_cuda_backend(int threads, bool tensor_cores, int gpu) {
  if (tensor_cores) return std::make_unique<DeviceBackend<CudaDevice>>("cuda", threads, gpu);
  return std::make_unique<DeviceBackend<WithoutTensorCores<CudaDevice>>>("cuda", threads, gpu);
}

std::unique_ptr<AllReduce> make_nccl_all_reduce(
    std::span<const std::unique_ptr<Backend>> backends) {
  std::vector<CudaDevice*> devices;
  for (const auto& backend : backends)
    devices.push_back(&dynamic_cast<DeviceBackend<CudaDevice>&>(*backend).raw_device());
  return std::make_unique<NcclAllReduce>(std::move(devices));
}

}  // namespace redrive::kernels
