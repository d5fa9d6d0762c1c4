// SPDX-License-Identifier: Apache-2.0
// The cpu backend's stages that every method uses: ranges of rays or numbers through an instruction
// set's kernels.
#include "redrive/base/buffer.h"
#include "redrive/kernels/check_sizes.h"
#include "redrive/kernels/cpu/composite_range.h"
#include "redrive/kernels/cpu/cpu_kernels.h"
#include "redrive/kernels/cpu/cpu_score.h"
#include "redrive/kernels/gaussian/cpu/cpu_gaussian_stages.h"
#include "redrive/kernels/grid/cpu/cpu_grid_stages.h"
#include "redrive/kernels/nerf/cpu/cpu_nerf_stages.h"
#include "redrive/optim/photometric_loss.h"

namespace redrive::kernels {
namespace {

void set_background(CompositeForward* rays, std::span<const float> background, int n_rays,
                    std::size_t first_ray) {
  rays->background = background.empty() ? nullptr : background.data() + first_ray;
  rays->background_stride = n_rays;
}

class CpuBackend final : public Backend {
 public:
  CpuBackend(Isa isa, int threads)
      : Backend(threads),
        isa_(isa),
        kernels_(isa == Isa::kAvx2 ? avx2::kCpuKernels : avx512::kCpuKernels) {}

  std::string name() const override { return "cpu"; }
  std::optional<Isa> isa() const override { return isa_; }

  void composite_forward(int n_rays, const Samples& samples, std::span<const float> raw,
                         std::span<const float> background, const CompositeOut& out) override {
    check_composite_forward(n_rays, samples, raw.size(), background, out);
    pool().run_ranges(n_rays, kRaysPerRange, [&](std::size_t begin, std::size_t end) {
      const RayRange range{static_cast<int>(begin), static_cast<int>(end - begin)};
      Buffer<float> scratch(composite_scratch(samples.per_ray));
      CompositeForward composite = composite_rays(
          range, samples, raw.data() + first_sample(range, samples), sample_count(n_rays, samples));
      set_background(&composite, background, n_rays, begin);
      kernels_.composite_forward(composite, composite_result(range, n_rays, samples, out),
                                 scratch.data());
    });
  }

  void composite_backward(int n_rays, const Samples& samples, std::span<const float> raw,
                          std::span<const float> background, const CompositeOutGradient& d_out,
                          std::span<float> d_raw) override {
    check_composite_backward(n_rays, samples, raw.size(), background, d_out, d_raw.size());
    const std::size_t stride = sample_count(n_rays, samples);
    pool().run_ranges(n_rays, kRaysPerRange, [&](std::size_t begin, std::size_t end) {
      const RayRange range{static_cast<int>(begin), static_cast<int>(end - begin)};
      Buffer<float> scratch(composite_scratch(samples.per_ray));
      const std::size_t first = first_sample(range, samples);
      CompositeForward composite = composite_rays(range, samples, raw.data() + first, stride);
      set_background(&composite, background, n_rays, begin);
      kernels_.composite_backward(
          composite,
          {.d_rgb = d_out.d_rgb.data() + begin,
           .d_rgb_stride = static_cast<std::size_t>(n_rays),
           .d_raw = d_raw.data() + first,
           .d_raw_stride = stride,
           .d_weights = d_out.d_weights.empty() ? nullptr : d_out.d_weights.data() + first},
          scratch.data());
    });
  }

  void photometric_loss(std::span<const float> rgb, std::span<const float> target,
                        std::span<float> d_rgb, double* loss) override {
    *loss = photometric_batch(rgb, target,
                              check_photometric(rgb.size(), target.size(), d_rgb.size()), d_rgb);
  }

  void adam(const AdamStep& step, std::span<float> gradients, std::span<float> parameters,
            std::span<float> first_moment, std::span<float> second_moment) override {
    check_adam(gradients.size(), parameters.size(), first_moment.size(), second_moment.size());
    pool().run_ranges(parameters.size(), 1 << 15, [&](std::size_t begin, std::size_t end) {
      kernels_.adam({.learning_rate = step.learning_rate,
                     .beta1 = step.beta1,
                     .beta2 = step.beta2,
                     .epsilon = step.epsilon,
                     .bias1 = step.bias1,
                     .bias2 = step.bias2,
                     .lazy = step.lazy,
                     .gradients = gradients.data() + begin,
                     .parameters = parameters.data() + begin,
                     .first_moment = first_moment.data() + begin,
                     .second_moment = second_moment.data() + begin,
                     .n = end - begin});
    });
  }

  ImageScore score(const ImagePair& images) override { return score_.score(images); }

  NerfStages& nerf() override { return *nerf_; }
  GridStages& grid() override { return *grid_; }
  GaussianStages& gaussians() override { return *gaussians_; }

 private:
  const Isa isa_;
  const CpuKernels& kernels_;
  CpuScore score_{isa_, &pool()};
  std::unique_ptr<NerfStages> nerf_ = make_cpu_nerf_stages(*this, isa_, kernels_, &pool());
  std::unique_ptr<GridStages> grid_ = make_cpu_grid_stages(isa_, &pool());
  std::unique_ptr<GaussianStages> gaussians_ = make_cpu_gaussian_stages(isa_, &pool());
};

}  // namespace

std::unique_ptr<Backend> make_cpu_backend(Isa isa, int threads) {
  if (const auto obstacle = isa_obstacle(isa)) throw UsageError("--isa", isa_name(isa), *obstacle);
  return std::make_unique<CpuBackend>(isa, threads);
}

}  // namespace redrive::kernels
