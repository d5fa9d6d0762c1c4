// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/roofline.h"

#include <algorithm>
#include <bit>

#include "redrive/base/error.h"
#include "redrive/bench/workload.h"
#include "redrive/camera/plain_camera.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/model/field_gaussians.h"
#include "redrive/model/method.h"
#include "redrive/optim/ssim.h"
#include "redrive/train/run.h"

namespace redrive::bench {

double StageCost::least_ms(const Gpu& gpu) const {
  return std::max(1e-9 * flops / gpu.tflops, 1e-6 * bytes / gpu.gb_per_s);
}

double StageCost::estimated_ms(const Gpu& gpu, const StageCost& measured) const {
  return least_ms(gpu) * measured.h200_ms / measured.least_ms(kGpus[0]);
}

std::vector<StageCost> step_costs(const StepCounts& of) {
  // Bytes are what shaders read and write, each number once a dispatch. Blending counts as if each
  // pixel of a tile met all its Gaussians; it keeps five numbers a pixel for each 256 pairs.
  constexpr double kWord = 4, kRecord = 64, kPairSums = 64, kSortedPair = 5 * kWord,
                   kState = 5 * kWord, kPixelsOfTile = kernels::kTileSide * kernels::kTileSide,
                   kBlend = 20, kBlendBackward = 60, kAdam = 25,
                   kHalo = 1 + 2.0 * kSsimRadius / kernels::kTileSide;
  double rows = 0;
  for (int row = 0; row < kDistanceRow; ++row) rows += is_seen(SeenBy::kCamera, row);
  const auto tiles = static_cast<unsigned>(of.pixels / kPixelsOfTile);
  const int tile_passes = (std::bit_width(tiles) + 7) / 8;
  // SSIM: taps of five moments along rows, with the halo, and columns; then of three slopes.
  const double loss = 3 * (kSsimTaps * (8 * kHalo + 10) + 40 + kSsimTaps * (6 * kHalo + 6) + 20);
  return {
      {"projection", kProjectOperations * of.drawn,
       4 * kWord * of.gaussians + ((rows - 3) * kWord + kRecord) * of.drawn, 0.03},
      {"compaction", 0, 2 * kWord * of.gaussians + 2 * kWord * of.drawn, 0.03},
      {"depth sort", 0, 3 * kSortedPair * of.drawn, 0.14},
      {"pairs", 2 * 30 * of.drawn,
       2 * (kRecord + kWord) * of.drawn + 3 * kWord * of.drawn + 4 * kWord * of.pairs, 0.06},
      {"tile sort", 0, (tile_passes * kSortedPair + kWord) * of.pairs, 0.10},
      {"blend", kBlend * kPixelsOfTile * of.pairs,
       (kRecord + 2 * kWord + kState) * of.pairs + 6 * kWord * of.pixels, 0.16},
      {"loss", loss * of.pixels, (2 * 4 + 2 * 9 + 3 + 3) * kWord * of.pixels, 0.10},
      {"blend backward", kBlendBackward * kPixelsOfTile * of.pairs,
       (kRecord + 2 * kWord + kPairSums + kState) * of.pairs + 8 * kWord * of.pixels, 0.50},
      {"sums", 16 * of.pairs, kPairSums * (of.pairs + of.drawn), 0.04},
      {"adjoint", kAdjointOperations * of.drawn, (2 * rows * kWord + kPairSums) * of.drawn, 0.02},
      {"update", kAdam * rows * of.drawn, (5 * rows + 3) * kWord * of.drawn, 0.05}};
}

std::vector<StepCost> count_steps(kernels::Backend& backend) {
  constexpr int kGaussians = 400'000;
  const SyntheticDrive drive = make_synthetic_drive();
  const auto method = std::ranges::find_if(
      methods(), [](const Method& m) { return m.benchmarks && m.benchmarks().fill; });
  REDRIVE_CHECK(method != methods().end());
  TrainOptions options;
  options.method = method->name;
  const TrainState state = make_initial_state(options, drive.scene);
  method->benchmarks().fill(drive, kGaussians, state.model.get());
  const View& view = drive.scene.views[0];
  const PlainCamera whole = make_plain_camera(drive.scene.rig[view.camera].camera);
  const ShutterPoses poses = drive.scene.shutter_poses(view);
  std::vector<StepCost> steps;
  for (const int parts : {2, 1}) {  // windows along a side, of which the counts are means
    StepCost step{whole.width / parts, whole.height / parts, {kGaussians, 0, 0, 0}, {}};
    for (int y = 0; y < parts; ++y)
      for (int x = 0; x < parts; ++x) {
        const kernels::GaussianCamera camera{
            window_of(whole, x * step.width, y * step.height, step.width, step.height),
            poses.keys(),
            static_cast<float>(y * step.height),
            static_cast<float>(whole.height),
            {}};
        const kernels::RasterCounts counts =
            backend.gaussians()
                .rasterise(camera, state.model->as_gaussians()->world().gaussians, {})
                .counts();
        step.counts.drawn += static_cast<double>(counts.visible) / (parts * parts);
        step.counts.pairs += static_cast<double>(counts.pairs) / (parts * parts);
      }
    step.counts.pixels = static_cast<double>(kernels::raster_size(step.width, step.height).plane());
    step.stages = step_costs(step.counts);
    steps.push_back(step);
  }
  return steps;
}

}  // namespace redrive::bench
