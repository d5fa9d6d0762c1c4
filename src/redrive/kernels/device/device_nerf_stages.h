// SPDX-License-Identifier: Apache-2.0
// The stages of --method nerf on a device: CommonNerfStages in kernels, and the network.
#pragma once

#include <algorithm>

#include "redrive/kernels/common_nerf_stages.h"
#include "redrive/kernels/device/nerf_functors.h"
#include "redrive/kernels/device/nerf_tensor_network.h"
#include "redrive/kernels/device/stage.h"

namespace redrive::kernels {

template <class Device>
class DeviceNerfStages final : public CommonNerfStages<DeviceExecutor<Device>> {
 public:
  DeviceNerfStages(Backend& backend, Device& device)
      : CommonNerfStages<DeviceExecutor<Device>>(backend, {&device}), device_(device) {}

  void network_forward(const NerfField& field, const Rays& rays, const Samples& samples,
                       std::span<float> raw) override {
    check_field(field, rays, samples);
    check_raw(rays.n, samples, raw.size());
    if (device_.has_tensor_cores())
      forward_by<NerfTensorNetwork<Device>>(field, rays, samples, raw);
    else
      forward_by<NerfFp32Network<Device>>(field, rays, samples, raw);
  }

  void network_backward(const NerfField& field, const Rays& rays, const Samples& samples,
                        std::span<const float> d_raw, std::span<float> gradients,
                        const RayGradients& of_rays) override {
    check_field_backward(field, rays, samples, d_raw.size(), gradients.size(), of_rays);
    if (device_.has_tensor_cores())
      backward_by<NerfTensorNetwork<Device>>(field, rays, samples, d_raw, gradients, of_rays);
    else
      backward_by<NerfFp32Network<Device>>(field, rays, samples, d_raw, gradients, of_rays);
  }

 private:
  template <class Pass>
  void forward_by(const NerfField& field, const Rays& rays, const Samples& samples,
                  std::span<float> raw) {
    const std::size_t n = sample_count(rays.n, samples),
                      most = std::min(n, Device::kMaxSamplesPerPass);
    Stage stage(device_);
    Pass pass(stage, stage_input(stage, field), most, {}, false);
    const Rays device_rays = stage_input(stage, rays);
    const Samples device_samples = stage_input(stage, samples);
    const std::span<float> out = stage.out(raw);
    for (std::size_t first = 0; first < n; first += most)
      pass.forward(device_rays, device_samples, first, std::min(most, n - first),
                   {&out[first], 1, n});
    stage.finish();
  }

  template <class Pass>
  void backward_by(const NerfField& field, const Rays& rays, const Samples& samples,
                   std::span<const float> d_raw, std::span<float> gradients,
                   const RayGradients& of_rays) {
    const std::size_t n = sample_count(rays.n, samples),
                      most = std::min(n, Device::kMaxSamplesPerPass);
    Stage stage(device_);
    Pass pass(stage, stage_input(stage, field), most, stage.in_out(gradients), of_rays.wanted());
    const Rays device_rays = stage_input(stage, rays);
    const Samples device_samples = stage_input(stage, samples);
    const std::span<const float> d = stage.in(d_raw);
    const std::span<float> d_position = stage.template scratch<float>(of_rays.wanted() ? 3 * n : 0);
    for (std::size_t first = 0; first < n; first += most) {
      const std::size_t count = std::min(most, n - first);
      pass.forward(device_rays, device_samples, first, count, {});
      pass.backward(count, {&d[first], 1, n},
                    {d_position.empty() ? nullptr : &d_position[first], 1, n});
    }
    if (of_rays.wanted())
      stage.for_each(rays.n, AddRayGradients{field.unit_from_world,
                                             rays.n,
                                             device_samples,
                                             d_position,
                                             {stage.in_out(of_rays.d_origin),
                                              stage.in_out(of_rays.d_direction)}});
    stage.finish();
  }

  Device& device_;
};

}  // namespace redrive::kernels
