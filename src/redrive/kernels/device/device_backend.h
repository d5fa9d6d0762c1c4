// SPDX-License-Identifier: Apache-2.0
// The backend of a Device (stage.h). Every stage copies its arguments to the device, runs functors
// on them and copies its results back, except for arrays that are resident on the device.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <type_traits>

#include "redrive/kernels/check_sizes.h"
#include "redrive/kernels/device/counting_device.h"
#include "redrive/kernels/device/device_grid_stages.h"
#include "redrive/kernels/device/device_image_score.h"
#include "redrive/kernels/device/device_nerf_stages.h"
#include "redrive/kernels/device/gather_functors.h"
#include "redrive/kernels/device/measure_ceilings.h"
#include "redrive/kernels/device/ray_functors.h"
#include "redrive/kernels/device/resident_sources.h"
#include "redrive/kernels/stage_spans.h"

namespace redrive::kernels {

template <class Device>
class DeviceBackend final : public Backend {
 public:
  /// threads: number of threads on the host, which load images.
  template <class... OfDevice>
  DeviceBackend(std::string name, int threads, const OfDevice&... of_device)
      : name_(std::move(name)), threads_(threads), device_(of_device...) {}

  std::string name() const override { return name_; }
  std::optional<Isa> isa() const override { return std::nullopt; }
  int threads() const override { return threads_; }

  std::shared_ptr<void> make_resident(std::span<const float> numbers) override {
    if (numbers.empty()) return nullptr;
    auto memory = device_.hold(numbers.size_bytes());
    device_.to_device(memory.get(), numbers.data(), numbers.size_bytes());
    device_.resident.add(numbers, memory);
    return memory;
  }
  void download(std::span<const float> part) override {
    if (const void* const memory = device_.resident.find(std::as_bytes(part)))
      device_.to_host(const_cast<float*>(part.data()), memory,
                      part.size_bytes());  // the host's copy is a non-const buffer
  }
  void upload(std::span<const float> part) override {
    if (void* const memory = device_.resident.find(std::as_bytes(part)))
      device_.to_device(memory, part.data(), part.size_bytes());
  }

  bool is_resident(std::span<const float> numbers) const override {
    return device_.resident.find(std::as_bytes(numbers)) != nullptr;
  }

  void fill(std::span<float> numbers, float value) override {
    Stage stage(device_);
    stage.for_each(numbers.size(), Fill{stage.out(numbers), value});
    stage.finish();
  }
  void mean(std::span<const float> numbers, double* mean) override {
    REDRIVE_CHECK_OP(numbers.size(), >, 0u);
    Stage stage(device_);
    const auto sum = stage.reduce(numbers.size(), ValueTerm<float>{stage.in(numbers)});
    stage.write_loss({sum, static_cast<double>(numbers.size())}, mean);
    stage.finish();
  }
  void not_finite(std::span<const float> numbers, double* count) override {
    Stage stage(device_);
    stage.write_loss({stage.reduce(numbers.size(), IsNotFinite{stage.in(numbers)})}, count);
    stage.finish();
  }
  void wait() override { device_.wait(); }
  std::optional<std::string> device() const override { return device_.description(); }
  std::optional<std::uint64_t> free_memory() override { return device_.free_memory(); }
  std::optional<Ceilings> ceilings() override {
    if constexpr (!kCounts) return measure_ceilings(device_);
    return std::nullopt;
  }
  std::unique_ptr<Backend> counting(MemoryCount* bytes) const override {
    if constexpr (!kCounts)
      return std::make_unique<DeviceBackend<Counting>>(name_, threads_, bytes,
                                                       device_.has_tensor_cores());
    return nullptr;
  }

  void gather_pixels(const PixelSource& from, const PixelDraw& draw, std::span<const float> errors,
                     const GatheredRays& out) override {
    check_gather_pixels(from, draw, errors.size(), out);
    const PixelSpans& pixels = resident_spans(device_, from);
    Stage stage(device_);
    const GatheredRays rays = {
        stage.out(out.origin),     stage.out(out.direction),   stage.out(out.target),
        stage.out(out.background), stage.out(out.pixel_angle), stage.out(out.weight),
        stage.out(out.exposure),   stage.out(out.view),        stage.out(out.cell)};
    const auto of_cells = stage.in(errors);
    const auto drawn = stage.template scratch<CellSample>(draw.error_map_rays);
    stage.for_each(rays.view.size(), GatherRays{pixels, draw, of_cells, rays, drawn});
    if (draw.error_map_rays > 0)
      stage.for_each(rays.view.size(),
                     WeightRays{draw, of_cells, stage.reduce(drawn.size(), DrawnPixelSum{drawn}),
                                stage.reduce(drawn.size(), DrawnErrorSum{drawn}), rays});
    stage.finish();
  }

  void gather_returns(const LidarSource& from, const LidarDraw& draw,
                      const GatheredReturns& out) override {
    check_gather_returns(from, out);
    const LidarSpans& returns = resident_spans(device_, from);
    Stage stage(device_);
    stage.for_each(out.range_m.size(),
                   GatherReturns{returns,
                                 draw,
                                 {stage.out(out.origin), stage.out(out.direction),
                                  stage.out(out.pixel_angle), stage.out(out.range_m)}});
    stage.finish();
  }

  void update_error_map(std::span<const std::uint32_t> cells, std::span<const float> squares,
                        std::span<float> errors) override {
    REDRIVE_CHECK_OP(cells.size(), ==, squares.size());
    Stage stage(device_);
    const std::size_t n = cells.size();
    const CellRayLists rays = {stage.in(cells),
                               stage.template scratch<std::uint32_t>(errors.size()),
                               stage.template scratch<std::uint32_t>(n)};
    stage.for_each(n, ClearRayLists{rays});
    stage.for_each(n, LinkRays{rays});
    stage.for_each(n, UpdateErrorMap{rays, stage.in(squares), stage.in_out(errors)});
    stage.finish();
  }

  void composite_forward(int n_rays, const Samples& samples, std::span<const float> raw,
                         std::span<const float> background, const CompositeOut& out) override {
    check_composite_forward(n_rays, samples, raw.size(), background, out);
    Stage stage(device_);
    stage.for_each(n_rays, CompositeRays{static_cast<std::size_t>(n_rays),
                                         stage_input(stage, samples),
                                         stage.in(raw),
                                         stage.in(background),
                                         {stage.out(out.rgb), stage.out(out.depth),
                                          stage.out(out.opacity), stage.out(out.weights)}});
    stage.finish();
  }

  void composite_backward(int n_rays, const Samples& samples, std::span<const float> raw,
                          std::span<const float> background, const CompositeOutGradient& d_out,
                          std::span<float> d_raw) override {
    check_composite_backward(n_rays, samples, raw.size(), background, d_out, d_raw.size());
    Stage stage(device_);
    stage.for_each(n_rays, CompositeRaysBackward{static_cast<std::size_t>(n_rays),
                                                 stage_input(stage, samples),
                                                 stage.in(raw),
                                                 stage.in(background),
                                                 {stage.in(d_out.d_rgb), stage.in(d_out.d_weights)},
                                                 stage.out(d_raw)});
    stage.finish();
  }

  void photometric_loss(std::span<const float> rgb, std::span<const float> target,
                        std::span<float> d_rgb, double* loss) override {
    const int n_rays = check_photometric(rgb.size(), target.size(), d_rgb.size());
    Stage stage(device_);
    stage.write_loss({stage.reduce(rgb.size(), PhotometricLoss{stage.in(rgb), stage.in(target),
                                                               n_rays, stage.out(d_rgb)})},
                     loss);
    stage.finish();
  }

  void adam(const AdamStep& step, std::span<float> gradients, std::span<float> parameters,
            std::span<float> first_moment, std::span<float> second_moment) override {
    check_adam(gradients.size(), parameters.size(), first_moment.size(), second_moment.size());
    Stage stage(device_);
    stage.for_each(parameters.size(),
                   AdamUpdate{step, stage.in_out(gradients), stage.in_out(parameters),
                              stage.in_out(first_moment), stage.in_out(second_moment)});
    stage.finish();
  }

  NerfStages& nerf() override { return nerf_; }
  GridStages& grid() override { return grid_; }

  ImageScore score(const ImagePair& images) override { return score_on_device(device_, images); }

  Device& raw_device() { return device_; }

 private:
  using Counting = CountingDevice<Device::kMaxSamplesPerPass, Device::kMaxGridSamplesPerPass>;
  static constexpr bool kCounts = std::is_same_v<Device, Counting>;

  std::string name_;
  int threads_;
  Device device_;
  DeviceNerfStages<Device> nerf_{*this, device_};
  DeviceGridStages<Device> grid_{device_};
};

}  // namespace redrive::kernels
