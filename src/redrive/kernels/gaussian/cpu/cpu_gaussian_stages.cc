// SPDX-License-Identifier: Apache-2.0
// The loss of images and the update of Gaussians; images: cpu_raster.h.
#include "redrive/kernels/gaussian/cpu/cpu_gaussian_stages.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/kernels/gaussian/check_gaussian_sizes.h"
#include "redrive/kernels/gaussian/cpu/cpu_raster.h"
#include "redrive/kernels/gaussian/target_window.h"
#include "redrive/optim/ssim.h"

namespace redrive::kernels {
namespace {

class CpuGaussianStages final : public GaussianStages {
 public:
  CpuGaussianStages(Isa isa, ThreadPool* pool)
      : kernels_(isa == Isa::kAvx2 ? avx2::kGaussianKernels : avx512::kGaussianKernels),
        pool_(*pool) {
    const SsimTaps taps = ssim_taps();
    std::ranges::copy(taps, taps_.begin());
  }

  Raster rasterise(const GaussianCamera& camera, const Gaussians& gaussians,
                   const RasterOptions& options) override {
    auto raster = arena_.take<CpuRaster>(
        [this] { return std::make_unique<CpuRaster>(kernels_, this, &pool_); });
    raster->forward(camera, gaussians, options);
    return {std::move(raster), &arena_};
  }

  ImageLossOutput image_loss(const ImageLossInput& input, std::span<float> d_rgb,
                             std::span<float> error) override {
    check_image_loss(input, d_rgb.size(), error.size());
    const std::size_t plane = input.size.plane(), rows = input.size.height,
                      across = input.size.stride / kPatchSide;
    float* const target = grown(&target_, 3 * plane);
    float* const mask = grown(&mask_, plane);
    float* const gains = grown(&gains_, 3 * plane);
    std::vector<TargetSums> targets(rows);
    ImageLossOutput out;
    out.patches.resize(plane / (kPatchSide * kPatchSide));
    pool_.run_ranges(rows, kPatchSide, [&](std::size_t begin, std::size_t end) {
      for (std::size_t y = begin; y < end; ++y)
        targets[y] = convert_target_row(input, static_cast<int>(y), target, mask, gains,
                                        &out.patches[begin / kPatchSide * across]);
    });
    TargetSums all;
    for (const TargetSums& row : targets) all.add(row);
    const double count = 3 * all.pixels;
    LossJob job;
    job.width = input.size.width;
    job.height = input.size.height;
    job.stride = input.size.stride;
    job.plane = plane;
    job.rgb = input.rgb.data();
    job.target = target;
    job.mask = mask;
    job.gains = gains;
    job.l1_scale = static_cast<float>(input.l1_weight / std::max(count, 1.0));
    job.ssim_scale = static_cast<float>(input.ssim_weight / std::max(count, 1.0));
    job.taps = taps_.data();
    job.masked = grown(&masked_, 6 * plane);
    job.moments = grown(&moments_, 15 * plane);
    job.slopes = grown(&slopes_, 9 * plane);
    job.d_rgb = d_rgb.data();
    job.error = error.data();
    // Rows below the image have tiles, too.
    const std::size_t end = rows * input.size.stride;
    for (std::size_t c = 0; c < 3; ++c)
      std::ranges::fill(d_rgb.subspan(c * plane + end, plane - end), 0.0f);
    std::ranges::fill(error.subspan(end, plane - end), 0.0f);
    std::vector<LossSums> sums(rows);
    for (int pass = 0; pass < kLossPasses; ++pass) {
      if (input.ssim_weight == 0 && pass > 0 && pass + 1 < kLossPasses) continue;
      pool_.run_ranges(rows, kPatchSide, [&](std::size_t begin, std::size_t end) {
        float* const scratch = tile_memory(loss_scratch(job.stride));
        for (std::size_t y = begin; y < end; ++y)
          kernels_.loss_row(job, pass, static_cast<int>(y), scratch, &sums[y]);
      });
    }
    double squares = 0;
    for (const LossSums& row : sums) {
      out.l1 += row.l1;
      out.dssim += row.ssim;
      squares += row.squares;
    }
    out.mse = squares / std::max(count, 1.0);
    all.finish(&out);
    return out;
  }

  void update_gaussians(const GaussianUpdate& update, std::size_t n,
                        std::span<const float> gradients, std::span<const float> errors) override {
    check_update_gaussians(update, n, gradients.size(), errors.size());
    const UpdateJob job = update_job(update);
    pool_.run_ranges(gaussian_blocks(n), kBlocksPerRange, [&](std::size_t begin, std::size_t end) {
      kernels_.update(job, gradients.data(), errors.data(), begin, end);
    });
  }
  void project_points(const GaussianCamera& camera, std::span<const float> points,
                      std::span<float> pixels) override {
    const std::size_t n = points.size() / 3;
    REDRIVE_CHECK_OP(pixels.size(), ==, 2 * n);
    const Segment segment = make_segment(camera, camera.world_from_camera, 0, 0);
    ProjectionJob job;
    job.camera = camera.camera;
    job.shutter = segment.shutter;
    constexpr std::size_t kPointsPerRange = 8192;
    pool_.run_ranges(n, kPointsPerRange, [&](std::size_t begin, std::size_t end) {
      kernels_.project_points(job, points.data(), n, begin, end, pixels.data());
    });
  }
  void release() override { arena_.release(); }

 private:
  const GaussianKernels& kernels_;
  ThreadPool& pool_;
  RasterArena arena_;
  std::array<float, kSsimTaps> taps_;
  Buffer<float> target_, mask_, gains_, masked_, moments_, slopes_;
};

}  // namespace

std::unique_ptr<GaussianStages> make_cpu_gaussian_stages(Isa isa, ThreadPool* pool) {
  return std::make_unique<CpuGaussianStages>(isa, pool);
}

}  // namespace redrive::kernels
