// SPDX-License-Identifier: Apache-2.0
// Hyperparameters of the splat model: names and ranges, values that follow from the scene,
// schedule, memory.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "redrive/methods/splat/actors/articulated.h"
#include "redrive/methods/splat/range_pixels.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/methods/splat/surface_planes.h"

namespace redrive {
namespace {

constexpr int kMostGaussians = 20'000'000;
// with fewer pixels each, images are fitted too closely
constexpr std::int64_t kPixelsPerGaussian = 64;
/// Each camera has an exposure for every photograph, its own or not.
constexpr std::size_t kMostPhotoCameras = 16;
constexpr std::int64_t kLeastPixelLimit = 20'000;

/// Records, keys and, with a sixteenth to spare, two pairs and their sums.
constexpr std::uint64_t kStepBytesPerGaussian = 64 + 8 + 2 * (16 + 64) * 17 / 16;
/// Numbers, moments and error.
constexpr std::uint64_t kBytesPerGaussian = (2 * kGaussianRows + 1) * sizeof(float);

constexpr double kUsual_s = 120, kGrowth = 0.35;  // max_gaussians over time

/// More Gaussians cost time a step: a short run converges better with fewer.
OptionValues gaussians_of_time(double seconds) {
  const double most = SplatModel().max_gaussians * std::pow(seconds / kUsual_s, kGrowth);
  return {{"max-gaussians", std::to_string(std::clamp<std::int64_t>(
                                std::llround(most / 1000) * 1000, 100'000, 1'000'000))}};
}

}  // namespace

Method splat_method() {
  return {
      .name = "splat",
      .help = "3D Gaussians, rasterised",
      .make = [] { return std::unique_ptr<Trainee>(std::make_unique<SplatModel>()); },
      .defaults = {{"max-seconds", "120"}},
      .presets = {{"fast", "", {{"max-seconds", "30"}}}, {"best", "", {{"max-seconds", "600"}}}},
      .defaults_of_time = gaussians_of_time,
      .refines_poses = true,
      .random_background = true,
      .contracts_space = true,
      .rasterises = true,
      .change_every = "densify_every",
      .benchmarks = splat_benchmarks};
}

std::string SplatModel::describe() const {
  return "at most " + std::to_string(most_gaussians()) + " Gaussians";
}

void SplatModel::visit_hyperparameters(HyperparameterVisitor& visit) {
  char most[120];
  std::snprintf(most, sizeof most,
                "number of Gaussians, at most; unless given, the default times (--max-seconds / "
                "%g)^%g",
                kUsual_s, kGrowth);
  visit(Hyperparameter{"max_gaussians", most, 1000, kMostGaussians}.as_option("max-gaussians"),
        max_gaussians);
  visit(Hyperparameter{"pixel_limit", "number of Gaussians, at most: one of 64 training pixels",
                       1000, kMostGaussians}
            .from_recording(),
        pixel_limit);
  visit(
      Hyperparameter{"initial.voxel",
                     "side of a voxel that keeps one first point, as a part of its distance", 0, 1}
          .exclusive(),
      initial.voxel);
  visit({"initial.sky", "first Gaussians on a sphere around the scene, seen or not", 0, 1'000'000},
        initial.sky);
  visit({"initial.random", "first Gaussians of a bounded scene without points", 0, 10'000'000},
        initial.random);
  visit({"initial.extruded",
         "share of the LiDAR returns above the cameras that are put once more, "
         "up to 9 m higher",
         0, 1},
        initial.extruded);
  int tracks = initial.tracks;
  visit({"initial.tracks", "1: points of image tracks are first Gaussians, too", 0, 1}, tracks);
  initial.tracks = tracks != 0;
  visit({"window_pixels", "pixels of a step; larger images are cut into windows", 4096, 1 << 28},
        window_pixels);
  visit({"coarse_progress", "part of the run in which images that are cut are halved first", 0, 1},
        coarse_progress);
  visit(Hyperparameter{"learning_rate", "learning rate of opacities at the start", 0, 1}
            .exclusive()
            .as_option("learning-rate"),
        initial_rate);
  visit(Hyperparameter{"lr_gamma", "factor of the learning rates at the end of the run", 0, 1}
            .exclusive()
            .as_option("lr-gamma"),
        last_rate);
  visit(
      {"position_rate", "learning rate of positions over distance, relative to opacities", 0, 100},
      position_rate);
  visit({"scale_rate", "learning rate of log scales, relative to opacities", 0, 100}, scale_rate);
  visit({"rotation_rate", "learning rate of quaternions, relative to opacities", 0, 100},
        rotation_rate);
  visit({"colour_rate", "learning rate of colours, relative to opacities", 0, 100}, colour_rate);
  visit({"harmonics_rate", "learning rate of harmonics of degree 1, relative to opacities", 0, 100},
        harmonics_rate);
  visit({"intensity_rate", "learning rate of LiDAR intensities, relative to opacities", 0, 100},
        intensity_rate);
  visit(
      {"return_rate", "learning rate of probabilities of a return, relative to opacities", 0, 100},
      return_rate);
  visit({"l1_weight", "weight of the mean absolute error", 0, 100}, l1_weight);
  visit({"ssim_weight", "weight of (1 - SSIM) / 2", 0, 100}, ssim_weight);
  visit({"range_weight", "weight of the error of LiDAR returns' log distances", 0, 1000},
        range_weight);
  visit(
      {"scan_every", "steps after which a part of a LiDAR scan is rendered, too; 0: never", 0, 1e6},
      scan_every);
  visit({"scan.range", "weight of the error of a scan's log distances", 0, 1000},
        scan_weights.range);
  visit({"scan.first", "parts of LiDAR scans that train before the first image", 0, 1e6},
        scans_first);
  visit({"scan.returns", "weight of the squared error of a ray's probability to return", 0, 1000},
        scan_weights.returns);
  visit({"scan.intensity", "weight of the squared error of intensities", 0, 1000},
        scan_weights.intensity);
  visit({"surface_rate", "part of the way onto planes of LiDAR returns, every 50 steps; 0: none", 0,
         1},
        surface_rate);
  visit(
      {"opacity_weight", "weight of the mean transmittance, unless a background is given", 0, 100},
      opacity_weight);
  visit(Hyperparameter{"lidar_rays", "0: LiDAR is not used", 0, 65536}.as_option("lidar-rays"),
        lidar_rays);
  visit({"actors", "1: moving objects are drawn; 0: they are masked", 0, 1}, actors);
  visit({"motion_rate", "learning rate of moving objects' tracks, m; 0: they stay", 0, 1},
        motion_rate);
  visit(Hyperparameter{"min_scale", "least scale of the two larger axes, as a part of the distance",
                       0, 1}
            .exclusive(),
        min_scale);
  visit(Hyperparameter{"max_scale", "largest scale of an axis, as a part of the distance", 0, 1000}
            .exclusive(),
        max_scale);
  visit(
      Hyperparameter{"min_opacity", "least opacity of Gaussians that are kept", 0, 0.5}.exclusive(),
      min_opacity);
  visit({"densify_every", "steps after which Gaussians are split and removed", 1, 1e9},
        densify_every);
  visit({"replaced",
         "part of the seen Gaussians that is removed then, those with the least errors, before "
         "grown_by",
         0, 0.5},
        replaced);
  visit(Hyperparameter{"grown_by", "progress at which max_gaussians is reached", 0, 1}.exclusive(),
        grown_by);
  visit({"densified_until", "progress after which the number of Gaussians stays", 0, 1},
        densified_until);
  visit({"averaged_every",
         "steps between two states in the mean that is the result, from densified_until on; 0: the "
         "last state is",
         0, 1e6},
        averaged_every);
  visit({"warm_up_steps", "steps in which the learning rates rise linearly", 0, 1e9},
        warm_up_steps);
  visit({"adam.beta2", "decay of Adam's second moment", 0, 0.999999}, beta2);
  visit(Hyperparameter{"adam.epsilon", "epsilon of Adam", 0, 1}.exclusive(), epsilon);
  visit(Hyperparameter{"appearance.cameras", "cameras with an exposure", 0, 1024}.from_recording(),
        gains.appearance.cameras);
  visit(
      {"appearance.knots", "knots of each camera's exposure over time; 0: no exposure", 0, 100'000},
      gains.appearance.knots);
  visit(
      Hyperparameter{"appearance.knot_spacing_s", "time between two knots, s", 0, 1e6}.exclusive(),
      gains.appearance.knot_spacing_s);
  visit({"exposure_rate", "part of the way to an image's best exposure, in a step", 0, 1},
        gains.exposure_rate);
  visit({"exposure_share", "part of it that all images of the camera take", 0, 1},
        gains.exposure_share);
  visit({"exposure_decay", "decay of log gains, in a step of their image", 0, 1},
        gains.exposure_decay);
  visit({"shading.columns", "cells of a camera's shading along its rows", 1, 1024},
        gains.shading.columns);
  visit({"shading.rows", "cells of a camera's shading along its columns", 1, 1024},
        gains.shading.rows);
  visit(Hyperparameter{"shading.cameras", "cameras with a shading", 0, 1024}.from_recording(),
        gains.shading.cameras);
  visit({"shading_rate", "part of the way to a cell's best gain, in a step", 0, 1},
        gains.shading_rate);
  visit({"shading_threshold", "differences of brightness (logarithm) that are not the shading's", 0,
         1},
        gains.shading_threshold);
}

void SplatModel::visit_state(HyperparameterVisitor& visit) {
  visit({"gaussians", "number of Gaussians of the world", 0, kMostGaussians}, gaussians);
  visit(
      Hyperparameter{"actor_ids", "ids of the moving objects that are drawn, by part"}.repeating(),
      actor_ids);
  visit({"actor_ends", "ends of their blocks of Gaussians", 1, kMostGaussians}, actor_ends);
  visit({"actor_keys", "ends of their tracks' keys", 1, kMostGaussians}, actor_keys);
  visit({"first_gaussians", "number of Gaussians at the start", 0, kMostGaussians},
        first_gaussians);
  visit({"unseen_gaussians", "number of them that no image sees", 0, kMostGaussians},
        unseen_gaussians);
  visit({"filled", "1: what objects hide in all images is filled", 0, 1}, filled);
  visit({"background.r", "colour where no Gaussian is", 0, 1}, background[0]);
  visit({"background.g", "colour where no Gaussian is", 0, 1}, background[1]);
  visit({"background.b", "colour where no Gaussian is", 0, 1}, background[2]);
}

void SplatModel::check(const HyperparameterFailure& fail) const {
  if (!(max_scale > min_scale))
    fail({"max_scale", ""}, std::to_string(max_scale), "must be above min_scale");
  if (actor_ids.size() != actor_keys.size())
    fail({"actor_keys", ""}, text_from_steps(actor_keys), "must be one for each of actor_ids");
  if (actor_ids.size() != actor_ends.size())
    fail({"actor_ends", ""}, text_from_steps(actor_ends), "must be one for each of actor_ids");
  for (std::size_t first = 0, end = 0; first < actor_ids.size(); first = end) {
    while (end < actor_ids.size() && actor_ids[end] == actor_ids[first]) ++end;
    if (end - first != 1 && end - first != kArticulatedParts)
      fail({"actor_ids", ""}, text_from_steps(actor_ids),
           "must have each number once or " + std::to_string(kArticulatedParts) + " times");
    for (std::size_t a = first; a < end && a < actor_keys.size(); ++a)
      if (motions_of(a).second != motions_of(first).second)
        fail({"actor_keys", ""}, text_from_steps(actor_keys),
             "must be as many for all parts of an object");
  }
  if (!actor_ends.empty() &&
      actor_ends.front() <= static_cast<std::int64_t>(gaussian_blocks(gaussians)))
    fail({"actor_ends", ""}, text_from_steps(actor_ends),
         "must be beyond the blocks of the world's Gaussians");
}

void SplatModel::configure(const Scene& scene) {
  if (scene.background != Background::kNone)
    std::ranges::copy(background_colour(scene.background), background);
  std::int64_t pixels = 0;
  for (const View& view : scene.views) {
    const Camera& camera = scene.rig[view.camera].camera;
    if (!view.held_out) pixels += std::int64_t{camera.width} * camera.height;
  }
  pixel_limit = static_cast<int>(
      std::clamp<std::int64_t>(pixels / kPixelsPerGaussian, kLeastPixelLimit, kMostGaussians));
  // Colours of an object before a given background are exact.
  const bool photographs = !scene.metric && scene.background == Background::kNone &&
                           scene.rig.size() <= kMostPhotoCameras;
  if ((scene.metric || photographs) && scene.frames.size() > 1) {
    // A knot for each frame: exposures change from image to image.
    const double seconds = scene.exposure(0, scene.frames.back().t_ns).t_s;
    gains.appearance.knot_spacing_s =
        static_cast<float>(seconds / static_cast<double>(scene.frames.size() - 1));
    gains.appearance.cameras = static_cast<int>(scene.rig.size());
    gains.appearance.knots = static_cast<int>(scene.frames.size());
  }
  if (scene.metric && scene.frames.size() > 1) {
    gains.shading.cameras = static_cast<int>(scene.rig.size());
    // Cells of at least two patches, also in halved images: smaller ones cannot be told apart and
    // run away.
    for (const RigCamera& rig : scene.rig) {
      const Camera& camera = rig.camera;
      const bool cut = std::int64_t{camera.width} * camera.height > window_pixels;
      const int cell = 2 * kernels::kPatchSide * (cut ? 2 : 1);
      gains.shading.columns = std::clamp(camera.width / cell, 1, gains.shading.columns);
      gains.shading.rows = std::clamp(camera.height / cell, 1, gains.shading.rows);
    }
  }
}

bool SplatModel::keeps_half_images(const Scene& scene) const {
  return coarse_progress > 0 && std::ranges::any_of(scene.rig, [&](const RigCamera& rig) {
           return std::int64_t{rig.camera.width} * rig.camera.height > window_pixels;
         });
}

std::size_t SplatModel::max_size() const {
  const std::size_t blocks = gaussian_blocks(static_cast<std::size_t>(most_gaussians()));
  return std::max(blocks + actor_ids.size(), layout().blocks()) * kBlockSize + gains.size() +
         actors_size();
}

std::vector<ModelTensor> SplatModel::tensors() const {
  const auto blocks = static_cast<std::int64_t>(layout().blocks());
  std::vector<ModelTensor> out;
  if (blocks > 0) out.push_back({"gaussians", {blocks, kGaussianRows, kGaussianBlock}, 0});
  const AppearanceConfig& appearance = gains.appearance;
  const ShadingConfig& shading = gains.shading;
  if (appearance.size() > 0)
    out.push_back({"appearance", {appearance.cameras, appearance.knots, 3}, blocks_size()});
  if (shading.size() > 0)
    out.push_back({"shading",
                   {shading.cameras, 3, shading.rows, shading.columns},
                   blocks_size() + appearance.size()});
  if (!actor_ids.empty())
    out.push_back({"actor_bounds",
                   {static_cast<std::int64_t>(actor_ids.size()), 3},
                   blocks_size() + gains.size()});
  if (!actor_ids.empty())
    out.push_back({"actor_motions",
                   {actor_keys.back(), static_cast<std::int64_t>(kMotionSize)},
                   blocks_size() + gains.size() + bounds_size()});
  return out;
}

std::vector<LossTerm> SplatModel::loss_terms(const StepSums& sums) const {
  return {{"l1", sums.terms[kL1Loss]},
          {"dssim", sums.terms[kSsimLoss]},
          {"opacity", sums.terms[kOpacityLoss]},
          {"lidar", sums.terms[kRangeLoss]},
          {"scans", sums.terms[kScanLoss], /*in_loss=*/false}};
}

double SplatModel::learning_rate(const Schedule& at) const {
  return exponential_decay_rate(initial_rate, last_rate, std::min(at.progress, 1.0), at.step,
                                warm_up_steps);
}

std::string SplatModel::describe_schedule(std::int64_t) const {
  char text[120];
  std::snprintf(text, sizeof text, "%d to %d Gaussians, learning rate %g, in the end times %g",
                first_gaussians, most_gaussians(), initial_rate, last_rate);
  return text;
}

std::uint64_t SplatModel::step_bytes() const {
  constexpr std::uint64_t kBytesPerPixel = 48 * sizeof(float);
  return kStepBytesPerGaussian * static_cast<std::uint64_t>(most_gaussians()) +
         kBytesPerPixel * static_cast<std::uint64_t>(window_pixels);
}

std::uint64_t SplatModel::device_bytes(kernels::Backend& backend) const {
  return backend.gaussians().training_bytes(static_cast<std::size_t>(most_gaussians()),
                                            static_cast<std::size_t>(window_pixels));
}

std::uint64_t SplatModel::lidar_bytes(const Scene& scene, std::uint64_t returns) const {
  if (lidar_rays == 0 || scene.frames.empty()) return 0;
  constexpr std::uint64_t kReturnsPerUnseen = 8;
  const std::uint64_t unseen =
      scan_every == 0 || unseen_gaussians > 0
          ? 0
          : std::min<std::uint64_t>(returns / kReturnsPerUnseen,
                                    static_cast<std::uint64_t>(max_gaussians));
  return unseen * (kBytesPerGaussian + kStepBytesPerGaussian) +
         (surface_rate > 0 ? surface_planes_bytes(returns) : 0) +
         (range_weight > 0 ? shown_return_bytes(scene, returns) : 0);
}

}  // namespace redrive
