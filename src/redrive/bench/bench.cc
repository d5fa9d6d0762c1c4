// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/bench.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <span>
#include <stdexcept>
#include <string_view>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/bench/commit.h"
#include "redrive/bench/peak.h"
#include "redrive/bench/workload.h"
#include "redrive/field/gaussian.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/model/method.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/render/renderer.h"
#include "redrive/train/poses/pose_refiner.h"
#include "redrive/train/run.h"
#include "redrive/train/step.h"

namespace redrive::bench {
namespace {

class Runner final : public Timer {
 public:
  Runner(kernels::Backend& backend, const Options& options, Report* report,
         const std::function<void(const Result&)>& on_result)
      : backend_(backend), options_(options), report_(report), on_result_(on_result) {}

  bool wanted(const std::string& name) const {
    return name.find(options_.filter) != std::string::npos;
  }

  void time(const std::string& name, double samples, const Cost& cost,
            const std::function<void()>& work) override {
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
    for (const auto& [stage, ms] : backend_.take_stage_times())
      result.stages_ms[stage] = ms / static_cast<double>(seconds.size());
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
    backend_.take_stage_times();
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

/// Returns the state of a fresh run of the method with this width and samples per ray.
TrainState make_state(const Method& method, const RayModelSize& size, const Scene& scene) {
  TrainOptions options;
  options.method = method.name;
  options.set("width", size.width);
  options.set("samples", size.samples);
  apply_preset(&options, {});
  return make_initial_state(options, scene);
}

/// Returns "nerf-256x96".
std::string name_of(const Method& method, const RayModelSize& size) {
  return method.name + "-" + std::to_string(size.width) + "x" + std::to_string(size.samples);
}

/// Returns the hyperparameter --batch.
int rays_of_step(Trainee* model) {
  for (const HyperparameterValue& value : hyperparameter_values(*model))
    if (value.what.option == "batch") return std::stoi(value.text);
  throw std::logic_error("the model marches no rays");
}

/// Times a whole training step, from sampling pixels to Adam.
void time_step(Runner& runner, kernels::Backend& backend, const SyntheticDrive& drive,
               const Method& method, const RayModelSize& size) {
  const std::string name = "step/" + name_of(method, size);
  if (!runner.wanted(name)) return;
  const PixelSampler sampler(drive.scene, drive.images, 1);
  const LidarReturns no_lidar;
  const TrainingSet data{drive.scene, drive.images, no_lidar, sampler};
  TrainState state = make_state(method, size, drive.scene);
  const int rays = rays_of_step(state.model.get());
  StepBuffers buffers;
  const double samples = 1.0 * rays * size.samples,
               parameters = static_cast<double>(state.model->size());
  // Each parameter is read and its gradient added to, then Adam. The number of grid rows that a
  // batch touches is unknown, so only the gradients that lazy Adam reads count.
  const bool lazy = state.model->adam_groups(0, 1).front().step.lazy;
  const double of_parameter = lazy ? kNumber : kNumber + kGradientBytes + kAdamBytes,
               bytes =
                   (kRayBytes + kColourBytes) / size.samples + parameters * of_parameter / samples;
  runner.time(name, samples, {3 * 2 * size.macs, bytes}, [&] {
    StepRequest request = next_step(state);
    request.pixels = rays;
    train_step(backend, data, request, state.model->learning_rate({}), &state, &buffers);
  });
}

void time_render(Runner& runner, kernels::Backend& backend, const SyntheticDrive& drive,
                 const Method& method, const RayModelSize& size, const std::string& filter) {
  const std::string name = "render/" + name_of(method, size) + "-1280x704";
  if (!runner.wanted(name)) return;
  // The reference backend would take hours; it runs only with an explicit filter.
  if (backend.name() == "ref" && filter.empty()) return;
  const TrainState state = make_state(method, size, drive.scene);
  const Camera& camera = drive.scene.rig[0].camera;
  const double samples = 1.0 * camera.width * camera.height * size.samples,
               bytes = (kRayBytes + kRenderedRayBytes) / size.samples +
                       kNumber * static_cast<double>(state.model->size()) / samples;
  runner.time(name, samples, {2 * size.macs, bytes}, [&] {
    render_image(backend, *state.model, camera,
                 drive.scene.world_from_camera(drive.scene.views[0]));
  });
}

/// A camera of 1400 x 1400, as fisheyes of sensor cars have it. parameters: the model's own.
Camera bench_camera(std::string_view model, double f, std::span<const double> parameters) {
  constexpr int kSide = 1400;
  CameraCalibration camera{
      "BENCH", std::string(model), {f, f, (kSide - 1) / 2.0, (kSide - 1) / 2.0}, kSide, kSide};
  camera.parameters.insert(camera.parameters.end(), parameters.begin(), parameters.end());
  return make_camera(camera);
}

/// Rays of one LiDAR revolution, from a car at 10 m/s in the middle of the street.
struct Revolution {
  std::vector<float> origin, direction;  ///< [3, n]

  kernels::Rays rays() const { return {static_cast<int>(origin.size() / 3), origin, direction}; }
};
Revolution make_revolution(int beams, int azimuth_steps) {
  constexpr double kAhead_m = 30, kHeight_m = 0.5, kSpeed_m_per_s = 10;
  LidarSensor lidar = *parse_lidar_sensor(std::to_string(beams));
  lidar.azimuth_steps = azimuth_steps;
  const LidarFirings firings = lidar.revolution(0);
  Revolution out;
  for (int k = 0; k < 3; ++k)
    for (std::size_t i = 0; i < firings.size(); ++i) {
      const double at[] = {kAhead_m + 1e-9 * double(firings.t_ns[i]) * kSpeed_m_per_s, 0,
                           kHeight_m};
      out.origin.push_back(static_cast<float>(at[k]));
      out.direction.push_back(static_cast<float>(firings.direction[i][k]));
    }
  return out;
}

/// Times whole images of Gaussians, a revolution of a LiDAR, and steps on one window: with 400,000
/// Gaussians, with twice as many, by a wide-angle camera, and where 50 objects have a quarter of
/// them. Rates count Gaussians.
void time_gaussians(Runner& runner, kernels::Backend& backend, const SyntheticDrive& drive,
                    const Method& method) {
  constexpr double kRead = kGaussianRows * sizeof(float);  // bytes of a Gaussian
  constexpr int kGaussians = 400'000;
  if (backend.name() == "ref") return;  // it would take hours
  const auto make_street = [&](const SyntheticDrive& of, int n) {
    TrainOptions options;
    options.method = method.name;
    TrainState state = make_initial_state(options, of.scene);
    method.benchmarks().fill(of, n, state.model.get());
    state.adam = state.model->zero_moments();
    return state;
  };
  const auto time_render = [&](const std::string& size, const Camera& camera) {
    const std::string name = "render/" + method.name + "-" + size;
    if (!runner.wanted(name)) return;
    const TrainState state = make_street(drive, kGaussians);
    state.model->freeze();
    const RayTable rays = make_ray_table(camera);
    RenderedImage image;
    runner.time(name, kGaussians, {0, kRead}, [&] {
      state.model->render_to(backend, rays, drive.scene.world_from_camera(drive.scene.views[0]), {},
                             &image);
    });
  };
  const auto time_scan = [&](int beams, int azimuth_steps) {
    const std::string name =
        "render/" + method.name + "-400k-lidar-" + std::to_string(beams * azimuth_steps);
    if (!runner.wanted(name)) return;
    const TrainState state = make_street(drive, kGaussians);
    state.model->freeze();
    const Revolution revolution = make_revolution(beams, azimuth_steps);
    runner.time(name, kGaussians, {0, kRead},
                [&] { state.model->trace(backend, revolution.rays()); });
  };
  const auto time_step = [&](const std::string& size, const SyntheticDrive& of, int gaussians) {
    const std::string name = "step/" + method.name + "-" + size + "-640x352";
    if (!runner.wanted(name)) return;
    TrainState state = make_street(of, gaussians);
    const PixelSampler sampler(of.scene, of.images, 1);
    const LidarReturns no_lidar;
    const TrainingSet data{of.scene, of.images, no_lidar, sampler};
    StepBuffers buffers;
    backend.gaussians().keep_targets(std::uint64_t{1} << 28);  // training keeps its images, too
    runner.time(name, gaussians, {0, kRead}, [&] {
      StepRequest request = next_step(state);
      request.progress = 0.9;  // full size
      // A rate of nearly 0: every repetition sees the same scene.
      train_step(backend, data, request, 1e-12, &state, &buffers);
    });
    state.model->fetch(backend);
  };
  time_render("400k-1280x704", drive.scene.rig[0].camera);
  time_render("400k-mei-1400x1400",
              bench_camera("mei", 820, std::array{0.0, 0.0, 0.0, 0.0, 0.0, 1.0}));
  time_render("400k-opencv_fisheye-1400x1400",
              bench_camera("opencv_fisheye", 430, OpenCvFisheye::kTypical));
  time_render("400k-opencv_rational-1400x1400",
              bench_camera("opencv_rational", 800, OpenCvRational::kTypical));
  time_scan(64, 2048);
  time_step("400k", drive, kGaussians);
  time_step("800k", drive, 2 * kGaussians);
  time_step("400k-wide", wide_angle(drive), kGaussians);
  SyntheticDrive with_actors = drive;
  add_actors(50, &with_actors);
  time_step("400k-50-actors", with_actors, kGaussians);
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
  for (const Method& method : methods()) {
    if (!method.benchmarks) continue;
    const MethodBenchmarks timed = method.benchmarks();
    if (!backend.marches_rays() && !timed.fill) continue;
    for (const RayModelSize& size : timed.sizes) {
      time_step(runner, backend, drive, method, size);
      if (size.renders) time_render(runner, backend, drive, method, size, options.filter);
    }
    if (timed.fill) time_gaussians(runner, backend, drive, method);
    if (timed.time_stages) timed.time_stages(backend, drive, &runner);
  }
  time_pose_update(runner);
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
                       {"limit", r.memory_bound ? "copies" : "arithmetic"},
                       {"stages_ms", r.stages_ms}});
  return {{"machine", machine}, {"results", results}};
}

}  // namespace redrive::bench
