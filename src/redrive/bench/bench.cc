// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/bench.h"

#include <algorithm>
#include <chrono>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/bench/commit.h"
#include "redrive/bench/peak.h"
#include "redrive/bench/workload.h"
#include "redrive/kernels/grid/grid_stages.h"
#include "redrive/kernels/nerf/nerf_stages.h"
#include "redrive/render/renderer.h"
#include "redrive/train/pose_refiner.h"
#include "redrive/train/step.h"

namespace redrive::bench {
namespace {

/// Cost per sample, or per other item that a Result counts.
struct Cost {
  double flops, bytes;
};

// Arithmetic of the scalar formulas, per sample (Adam: per parameter), counted from the named
// files.
constexpr double kStratifiedFlops =
    4;  // volume/hierarchical_sampling.h: two for t, one for u, one for dt
constexpr double kCompositeFlops = 24;  // volume/composite.h: alpha 3, w 1, three colours of 6, T 2
constexpr double kCompositeBackwardFlops =
    44;                            // volume/composite.h: T and w 6, three colours of 12, sigma 2
constexpr double kAdamFlops = 14;  // optim/adam.h: m 3, v 4, parameter 7

// Bytes that a stage of the backend interface reads and writes at least, each number once, however
// often a kernel reads it. Bytes of a ray are divided among its samples, bytes of parameters among
// all samples of a run.
constexpr double kNumber = sizeof(float);
constexpr double kRayBytes = 6 * kNumber;          // origin and direction
constexpr double kColourBytes = 3 * kNumber;       // for each ray: target, or its derivative
constexpr double kRenderedRayBytes = 5 * kNumber;  // for each ray: colour, depth, opacity
// for each sample: colour and density, or their derivatives
constexpr double kRawBytes = 4 * kNumber;
constexpr double kIntervalBytes = 2 * kNumber;  // t and dt
constexpr double kAdamBytes =
    2 * 4 * kNumber;  // gradient, parameter, two moments: read and written
constexpr double kGradientBytes = 2 * kNumber;  // added to
constexpr double kPointBytes = 4 * kNumber;     // in the unit cube: position and footprint

class Runner {
 public:
  Runner(kernels::Backend& backend, const Options& options, Report* report,
         const std::function<void(const Result&)>& on_result)
      : backend_(backend), options_(options), report_(report), on_result_(on_result) {}

  bool wanted(const std::string& name) const {
    return name.find(options_.filter) != std::string::npos;
  }

  /// Times `work`, which processes `samples` samples at a cost each.
  void time(const std::string& name, double samples, const Cost& cost,
            const std::function<void()>& work) {
    if (!wanted(name)) return;
    const std::vector<double> seconds = measure(work);
    Result result;
    result.name = name;
    const double median = seconds[seconds.size() / 2];
    result.median_ms = 1e3 * median;
    result.min_ms = 1e3 * seconds.front();
    result.samples_per_s = samples / median;
    result.flops = samples * cost.flops;
    result.bytes = samples * cost.bytes;
    result.gflops = 1e-9 * result.flops / median;
    const double computing = 1e-9 * result.flops / report_->ceilings.gflops,
                 copying = 1e-9 * result.bytes / report_->ceilings.copy_gb_per_s;
    result.memory_bound = copying > computing;
    result.percent_of_roofline = 100 * std::max(computing, copying) / median;
    report_->results.push_back(result);
    on_result_(result);
  }

 private:
  /// Returns the seconds of each repetition, ascending.
  std::vector<double> measure(const std::function<void()>& work) const {
    constexpr double kLong = 20, kEnough = 3;
    constexpr std::size_t kAtLeast = 5;
    const auto run = [&] {
      const auto start = std::chrono::steady_clock::now();
      work();
      return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    };
    std::vector<double> seconds;
    const double warm_up = run();
    if (warm_up > kLong && options_.repetitions <= 1) return {warm_up};
    for (double sum = 0;
         options_.repetitions > 0 ? seconds.size() < static_cast<std::size_t>(options_.repetitions)
                                  : seconds.size() < kAtLeast || sum < kEnough;
         sum += seconds.back())
      seconds.push_back(run());
    std::sort(seconds.begin(), seconds.end());
    return seconds;
  }

  kernels::Backend& backend_;
  const Options& options_;
  Report* report_;
  const std::function<void(const Result&)>& on_result_;
};

/// A method with its network's width and its samples per ray.
struct Size {
  const char* method;
  int width, samples;
};

/// Times a whole training step, from sampling pixels to Adam.
void time_step(Runner& runner, kernels::Backend& backend, const SyntheticDrive& drive,
               const std::string& name, const Size& size, double forward_macs) {
  if (!runner.wanted(name)) return;
  const PixelSampler sampler(drive.scene, drive.images, 1);
  const LidarReturns no_lidar;
  const TrainingSet data{drive.scene, drive.images, no_lidar, sampler};
  TrainState state =
      make_initial_state(options_of(size.method, size.width, size.samples), drive.scene);
  const int rays = dynamic_cast<const RayModel&>(*state.model).batch_rays;
  StepBuffers buffers;
  const double samples = 1.0 * rays * size.samples,
               parameters = static_cast<double>(state.model->size());
  // Each parameter is read and its gradient added to, then Adam. The number of grid rows that a
  // batch touches is unknown, so only the gradients that lazy Adam reads count.
  const bool lazy = state.model->adam_groups(0, 1).front().step.lazy;
  const double of_parameter = lazy ? kNumber : kNumber + kGradientBytes + kAdamBytes,
               bytes =
                   (kRayBytes + kColourBytes) / size.samples + parameters * of_parameter / samples;
  runner.time(name, samples, {3 * 2 * forward_macs, bytes}, [&] {
    StepRequest request = next_step(state);
    request.pixels = rays;
    train_step(backend, data, request, state.model->learning_rate({}), &state, &buffers);
  });
}

void time_render(Runner& runner, kernels::Backend& backend, const SyntheticDrive& drive,
                 const std::string& name, const Size& size, double forward_macs,
                 const std::string& filter) {
  if (!runner.wanted(name)) return;
  // The reference backend would take hours; it runs only with an explicit filter.
  if (backend.name() == "ref" && filter.empty()) return;
  const TrainState state =
      make_initial_state(options_of(size.method, size.width, size.samples), drive.scene);
  const Camera& camera = drive.scene.rig[0].camera;
  const double samples = 1.0 * camera.width * camera.height * size.samples,
               bytes = (kRayBytes + kRenderedRayBytes) / size.samples +
                       kNumber * static_cast<double>(state.model->size()) / samples;
  runner.time(name, samples, {2 * forward_macs, bytes}, [&] {
    render_image(backend, *state.model, camera,
                 drive.scene.world_from_camera(drive.scene.views[0]));
  });
}

/// A fisheye of 1400 x 1400 as sensor cars have it, Mei's model with xi of 1.
Camera bench_fisheye() {
  constexpr int kSide = 1400;
  return make_camera({"FISHEYE",
                      "mei",
                      {820, 820, (kSide - 1) / 2.0, (kSide - 1) / 2.0, 0, 0, 0, 0, 0, 1},
                      kSide,
                      kSide});
}

/// Times whole images of --method splat and steps on one window, also with twice the Gaussians, and
/// with as many of which 50 objects have a quarter. A sample is a Gaussian.
void time_splats(Runner& runner, kernels::Backend& backend, const SyntheticDrive& drive) {
  constexpr double kRead = kGaussianRows * sizeof(float);  // bytes of a Gaussian
  constexpr int kGaussians = 400'000;
  const std::string pinhole = "render/splat-400k-1280x704",
                    fisheye = "render/splat-400k-mei-1400x1400", step = "step/splat-400k-640x352",
                    twice = "step/splat-800k-640x352",
                    traffic = "step/splat-400k-50-actors-640x352";
  if (backend.name() != "cpu") return;  // ref would take hours
  const auto time_render = [&](const std::string& name, const Camera& camera) {
    if (!runner.wanted(name)) return;
    const TrainState state = make_splat_state(drive, kGaussians);
    const RayTable rays = make_ray_table(camera);
    RenderedImage image;
    runner.time(name, kGaussians, {0, kRead}, [&] {
      state.model->render_to(backend, rays, drive.scene.world_from_camera(drive.scene.views[0]), {},
                             &image);
    });
  };
  const auto time_step = [&](const std::string& name, const SyntheticDrive& of, int gaussians) {
    if (!runner.wanted(name)) return;
    TrainState state = make_splat_state(of, gaussians);
    const PixelSampler sampler(of.scene, of.images, 1);
    const LidarReturns no_lidar;
    const TrainingSet data{of.scene, of.images, no_lidar, sampler};
    StepBuffers buffers;
    runner.time(name, gaussians, {0, kRead}, [&] {
      StepRequest request = next_step(state);
      request.progress = 0.9;  // full size
      // A rate of nearly 0: every repetition sees the same scene.
      train_step(backend, data, request, 1e-12, &state, &buffers);
    });
  };
  time_render(pinhole, drive.scene.rig[0].camera);
  time_render(fisheye, bench_fisheye());
  time_step(step, drive, kGaussians);
  time_step(twice, drive, 2 * kGaussians);
  SyntheticDrive with_actors = drive;
  add_actors(50, &with_actors);
  time_step(traffic, with_actors, kGaussians);
}

/// Times an update of the poses of a long drive after a step that drew one image: the corrections
/// from the derivatives, then the scene's poses from the corrections. A sample is a frame.
void time_pose_update(Runner& runner) {
  constexpr int kFrames = 10'000, kCameras = 6;
  constexpr const char* kName = "pose-update/10000-frames-6-cameras";
  if (!runner.wanted(kName)) return;
  Scene scene;
  scene.rig.resize(kCameras);
  for (RigCamera& camera : scene.rig) {
    camera.body_from_sensor = Rigid3d::Identity();
    camera.readout_ns = 30'000'000;
  }
  for (int f = 0; f < kFrames; ++f)
    scene.add_frame({f, f * 100'000'000ll, Rigid3d(Eigen::Translation3d(0.5 * f, 0, 0))});
  for (int c = 0; c < kCameras; ++c)
    for (int f = 0; f < kFrames; ++f) scene.views.push_back({c, f, ""});
  PoseState state(scene);
  std::vector<ViewGradient> gradients(scene.views.size());
  gradients[kFrames / 2] = {Eigen::Vector3d(1, 2, 3), Eigen::Vector3d(3, 2, 1)};
  runner.time(kName, kFrames, {0, 0}, [&] {
    refine_poses(scene, gradients, pose_rates(1e-3), PoseRefinement(), &state);
    scene.correct(state.corrections);
  });
}

void time_kernels(Runner& runner, kernels::Backend& backend, const SyntheticDrive& drive) {
  const NerfConfig config;
  KernelBatch b(drive, config, 96);
  const double samples = static_cast<double>(b.t.size()),
               forward_flops = 2 * nerf_macs_per_sample(config);
  const double per_ray = b.model().samples,
               parameters = static_cast<double>(b.gradients.size()) / samples;
  // The last sample has no dt.
  const double field_bytes = kRayBytes / per_ray + kNumber + kRawBytes + kNumber * parameters;
  const auto field = b.model().field(0);
  runner.time("kernel/sample_stratified", samples, {kStratifiedFlops, kIntervalBytes},
              [&] { backend.nerf().sample_stratified(b.rays.n, b.sampling(), b.t, b.dt); });
  runner.time("kernel/nerf_forward-256", samples, {forward_flops, field_bytes}, [&] {
    backend.nerf().network_forward(field, b.ray_spans(), b.sample_spans(), b.raw);
  });
  // Includes recomputing the forward pass.
  runner.time("kernel/nerf_backward-256", samples,
              {3 * forward_flops, field_bytes + kGradientBytes * parameters}, [&] {
                backend.nerf().network_backward(field, b.ray_spans(), b.sample_spans(), b.d_raw,
                                                b.gradients, {});
              });
  runner.time("kernel/composite_forward", samples,
              {kCompositeFlops, kIntervalBytes + kRawBytes + kRenderedRayBytes / per_ray}, [&] {
                backend.composite_forward(b.rays.n, b.sample_spans(), b.raw, {},
                                          {b.rgb, b.depth, b.opacity, {}});
              });
  // Reads densities and colours, writes their derivatives.
  runner.time(
      "kernel/composite_backward", samples,
      {kCompositeBackwardFlops, kIntervalBytes + 2 * kRawBytes + kColourBytes / per_ray}, [&] {
        backend.composite_backward(b.rays.n, b.sample_spans(), b.raw, {}, {b.d_rgb, {}}, b.d_raw);
      });
  runner.time("kernel/adam", static_cast<double>(b.gradients.size()), {kAdamFlops, kAdamBytes},
              [&] {
                backend.adam(adam_step(5e-4, 1), b.gradients, b.state.model->parameters,
                             b.state.adam.first_moment, b.state.adam.second_moment);
              });
}

void time_grid_kernels(Runner& runner, kernels::Backend& backend, const SyntheticDrive& drive) {
  GridBatch b(backend, drive);
  kernels::GridStages& stages = backend.grid();
  const int n = b.rays.n;
  const double samples = static_cast<double>(b.points.n), levels = b.model().field.grid.n_levels,
               features = b.model().field.grid.features_per_level,
               macs = grid_macs_per_sample(b.model().field);
  // Per level: three coordinates of 3, eight weights of 2, eight rows of 2 operations a feature.
  // The adjoint takes twice as many.
  const double encode_flops = levels * (25 + 16 * features);
  // Eight rows per level, at most the level's rows per batch, which samples share.
  const double rows_bytes = std::min(levels * 8 * features * kNumber,
                                     kNumber * static_cast<double>(b.d_table.size()) / samples);
  const double features_bytes = levels * features * kNumber;
  const double weights = static_cast<double>(b.d_weights.size()) / samples;
  const double network_bytes =
      features_bytes + kHarmonics * kNumber / GridBatch::per_ray + kRawBytes + kNumber * weights;
  runner.time("kernel/grid_encode", samples,
              {encode_flops, kPointBytes + features_bytes + rows_bytes},
              [&] { stages.encode(b.grid(), b.points, b.features); });
  runner.time(
      "kernel/grid_encode_backward", samples,
      {2 * encode_flops, kPointBytes + features_bytes + 2 * rows_bytes},  // rows are added to
      [&] { stages.encode_backward(b.grid(), b.points, b.features, b.d_table, {}); });
  runner.time("kernel/grid_network_forward", samples, {2 * macs, network_bytes}, [&] {
    stages.network_forward(b.network(), n, b.per_ray, b.features, b.harmonics, b.raw);
  });
  // Includes recomputing the forward pass.
  runner.time("kernel/grid_network_backward", samples,
              {6 * macs, network_bytes + features_bytes + kGradientBytes * weights}, [&] {
                stages.network_backward(b.network(), n, b.per_ray, b.features, b.harmonics, b.raw,
                                        b.d_weights, b.d_features);
              });
}

}  // namespace

Report run(kernels::Backend& backend, const Options& options,
           const std::function<void(const Result&)>& on_result) {
  Report report;
  report.cpu = cpu_model_name();
  report.backend = backend.name();
  report.isa = backend.isa() ? std::string(isa_name(*backend.isa())) : "none";
  report.threads = backend.threads();
  report.commit = kCommit;
  report.ceilings = {measure_peak_gflops(backend.isa(), backend.pool()),
                     report.isa == "none" ? "sse2" : report.isa,
                     measure_copy_gb_per_s(backend.pool())};

  Runner runner(backend, options, &report, on_result);
  const SyntheticDrive drive = make_synthetic_drive();
  constexpr Size wide{"nerf", 256, 96}, narrow{"nerf", 128, 48}, grid{"grid", 32, 24};
  const double wide_macs = nerf_macs_per_sample({wide.width}),
               narrow_macs = nerf_macs_per_sample({narrow.width}),
               grid_macs = grid_macs_per_sample(GridModel{}.field);
  time_step(runner, backend, drive, "step/nerf-256x96", wide, wide_macs);
  time_step(runner, backend, drive, "step/nerf-128x48", narrow, narrow_macs);
  time_step(runner, backend, drive, "step/grid-32x24", grid, grid_macs);
  time_splats(runner, backend, drive);
  time_pose_update(runner);
  time_kernels(runner, backend, drive);
  time_grid_kernels(runner, backend, drive);
  time_render(runner, backend, drive, "render/nerf-256x96-1280x704", wide, wide_macs,
              options.filter);
  time_render(runner, backend, drive, "render/grid-32x24-1280x704", grid, grid_macs,
              options.filter);
  if (report.results.empty())
    throw UsageError("--filter", options.filter, "no benchmark's name contains it");
  return report;
}

nlohmann::json to_json(const Report& report) {
  nlohmann::json machine = {{"cpu", report.cpu},
                            {"isa", report.isa},
                            {"backend", report.backend},
                            {"threads", report.threads},
                            {"peak_gflops", report.ceilings.gflops},
                            {"peak_arithmetic", report.ceilings.arithmetic},
                            {"peak_copied_gb_s", report.ceilings.copy_gb_per_s}};
  if (!report.commit.empty()) machine["commit"] = report.commit;
  nlohmann::json results = nlohmann::json::array();
  for (const Result& r : report.results)
    results.push_back({{"name", r.name},
                       {"median_ms", r.median_ms},
                       {"min_ms", r.min_ms},
                       {"samples_per_s", r.samples_per_s},
                       {"flops", r.flops},
                       {"bytes", r.bytes},
                       {"gflops", r.gflops},
                       {"percent_of_roofline", r.percent_of_roofline},
                       {"limit", r.memory_bound ? "copies" : "arithmetic"}});
  return {{"machine", machine}, {"results", results}};
}

}  // namespace redrive::bench
