// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/cpu/cpu_score.h"

#include <vector>

namespace redrive::kernels {

CpuScore::CpuScore(Isa isa, ThreadPool* pool)
    : kernels_(isa == Isa::kAvx2 ? avx2::kScoreKernels : avx512::kScoreKernels), pool_(*pool) {}

ImageScore CpuScore::score(const ImagePair& images) {
  check_image_pair(images);
  constexpr std::size_t kPadded = 16, kRowsAtOnce = 8;
  ScoreJob job;
  job.width = images.width;
  job.height = images.height;
  job.stride = (static_cast<std::size_t>(images.width) + kPadded - 1) / kPadded * kPadded;
  job.rgb = images.rgb.data();
  job.ground_truth = images.ground_truth.data();
  job.mask = images.mask.empty() ? nullptr : images.mask.data();
  job.flip = &filters_;
  const SsimTaps taps = ssim_taps();
  for (int i = 0; i < kSsimTaps; ++i) job.taps[i] = static_cast<float>(taps[i]);
  const std::size_t rows = images.height, planes = 2 * kScorePlanes * rows * job.stride;
  if (planes_.size() < planes) planes_ = Buffer<float>(planes);
  job.planes = planes_.data();

  std::vector<ScoreSums> of_row(rows);
  pool_.run_ranges(rows, kRowsAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y)
      kernels_.fill_row(job, static_cast<int>(y), &of_row[y]);
  });
  pool_.run_ranges(rows, kRowsAtOnce, [&](std::size_t begin, std::size_t end) {
    Buffer<float> scratch(score_scratch(job.stride));
    for (std::size_t y = begin; y < end; ++y)
      kernels_.score_row(job, static_cast<int>(y), scratch.data(), &of_row[y]);
  });
  return score_from_sums(of_row);
}

}  // namespace redrive::kernels
