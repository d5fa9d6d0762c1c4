// SPDX-License-Identifier: Apache-2.0
// redrive plan RECORDING: predicts what `redrive train` with the same options will cost. Measures
// on a few images; for the others it reads only sizes.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/memory_limit.h"
#include "redrive/cli/command.h"
#include "redrive/cli/help.h"
#include "redrive/cli/json_output.h"
#include "redrive/cli/notes.h"
#include "redrive/cli/train/training.h"
#include "redrive/perception/seen_through.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/wording.h"
#include "redrive/train/divided_run.h"
#include "redrive/train/memory.h"
#include "redrive/train/plan.h"

namespace redrive {
namespace {

/// Options of train that change what it costs.
constexpr const char* kPlannedOptions[] = {
    "cameras", "frames",        "downscale", "holdout-every", "train-every", "masks",      "method",
    "preset",  "max-gaussians", "max-steps", "max-seconds",   "lidar-rays",  "set",        "memory",
    "backend", "isa",           "device",    "threads",       "truth-poses", "max-damaged"};
constexpr double kCalibrationPixels = 4e6;  // pixels to measure on: some seconds of work
constexpr std::int64_t kLeastCalibrationImages = 6;

struct PlanArguments {
  std::string recording;
  GivenFields given;
  std::string blocks;  ///< metres or auto; empty: the drive is not divided
  int machines = 1, cores = 0;
  bool json = false;
};

TrainOptions options_of(const PlanArguments& arguments) {
  TrainOptions options;
  std::vector<std::string> names;
  options.recording = arguments.recording;
  parse_given(arguments.given, &options);
  for (const auto& [name, values] : arguments.given) names.push_back(name);
  validate_fields(options);
  apply_preset(&options, names);
  validate(options);
  if (options.max_steps == 0 && options.max_seconds == 0)
    throw UsageError("--max-steps", "", "or --max-seconds must limit the run");
  return options;
}

std::uint64_t size_of(const std::filesystem::path& file) {
  if (const std::optional<std::uint64_t> size = file_bytes(file)) return *size;
  throw InputError(file, "", "", "no such file, or not readable");
}

/// Sets the model of a run whose options and scene are set.
void set_model(Run* run) { run->state.model = make_run_model(run->options, run->scene); }

Run run_of(const TrainOptions& options, const Recording& recording) {
  Run run;
  run.options = options;
  run.recording = recording;
  run.scene = make_scene(run.recording, scene_options(options));
  set_model(&run);
  return run;
}

PlannedBlock planned(const Block& block, const Run& run, int threads) {
  PlannedBlock out;
  out.name = block.name;
  out.first_frame = run.scene.frames.front().id;
  out.last_frame = run.scene.frames.back().id;
  out.length_m = block.end_m - block.start_m;
  for (const View& view : run.scene.views) {
    if (view.held_out) continue;
    ++out.images;
    out.image_file_bytes += size_of(view.image);
  }
  if (run.state.model->uses_lidar())
    for (const FrameFile& file : run.recording.lidar_files)
      if (file.frame_id >= out.first_frame && file.frame_id <= out.last_frame)
        out.lidar_file_bytes += size_of(file.path);
  out.cameras = std::ssize(run.scene.rig);
  if (!run.recording.lidar_files.empty())
    out.sweeps = 1 + std::llround(1e-9 / kSweep_s *
                                  static_cast<double>(run.scene.frames.back().t_ns -
                                                      run.scene.frames.front().t_ns));
  const MemoryEstimate need = estimate_memory(run, threads);
  out.memory_bytes = need.total();
  out.least_memory_bytes = need.least();
  out.checkpoint_bytes = need.saving;
  return out;
}

/// Returns the number of images to measure on.
std::int64_t calibration_images(const Scene& scene) {
  double pixels = 0;
  for (const View& view : scene.views) {
    const Camera& camera = scene.rig[view.camera].camera;
    pixels += static_cast<double>(camera.width) * camera.height;
  }
  return std::max(kLeastCalibrationImages,
                  static_cast<std::int64_t>(kCalibrationPixels /
                                            (pixels / static_cast<double>(scene.views.size()))));
}

/// Returns a run of the `n` frames in the middle of `whole`. Numbers that follow from the images,
/// such as the maximum of Gaussians, follow from the images of `whole`.
Run middle_of(const Run& whole, TrainOptions options, const Recording& recording, std::int64_t n) {
  const std::vector<Frame>& frames = whole.scene.frames;
  const std::int64_t before = (std::ssize(frames) - n) / 2;
  const std::int64_t first = frames[std::size_t(before)].id,
                     last = frames[std::size_t(before + n - 1)].id;
  options.frames = std::to_string(first) + ":" + std::to_string(last) + ":" +
                   std::to_string(parse_frame_range(options.frames).step);
  options.holdout_every = options.train_every = 0;
  Run run = run_of(options, recording);
  std::erase_if(run.recording.lidar_files, [&](const FrameFile& file) {
    return file.frame_id < first || file.frame_id > last;
  });
  run.state = make_initial_state(options, whole.scene);
  return run;
}

/// Measures on the frames in the middle of a block that have calibration_images.
TrainingRates measured(const TrainOptions& whole, const Recording& recording, const Block& block,
                       kernels::Backend& backend) {
  TrainOptions options = block_options(whole, block);
  const Run all = run_of(options, recording);
  const std::int64_t images = std::ssize(all.scene.views), frames = std::ssize(all.scene.frames),
                     n = std::min(frames,
                                  (calibration_images(all.scene) * frames + images - 1) / images);
  CalibrationSteps calibration;
  const char* const change_every = find_method(options.method)->change_every;
  if (change_every && !options.hyperparameters.contains(change_every))
    options.set(change_every, calibration.change_every);
  else
    calibration.change_every_of_run = calibration.change_every;
  Run run = middle_of(all, options, recording, n);
  std::optional<Run> fewer;
  if (n > 1) fewer = middle_of(all, options, recording, n / 2);
  TrainingRates rates = measure_rates(&run, backend, calibration, fewer ? &*fewer : nullptr);
  measure_left_out(options, recording, all.scene, backend, &rates);
  return rates;
}

std::string time_text(double seconds) {
  char text[40];
  if (seconds < 120)
    std::snprintf(text, sizeof text, "%.0f s", seconds);
  else if (seconds < 7200)
    std::snprintf(text, sizeof text, "%.0f min", seconds / 60);
  else
    std::snprintf(text, sizeof text, "%.1f h", seconds / 3600);
  return text;
}

std::string bytes_text(double bytes) {
  char text[40];
  std::snprintf(text, sizeof text, bytes < 1e9 ? "%.0f MB" : "%.1f GB",
                bytes < 1e9 ? bytes / 1e6 : bytes / 1e9);
  return text;
}

/// A measured run of --method splat: its score after so many steps an image (docs/benchmarks.md).
struct MeasuredRun {
  bool metric;
  const char* what;
  double steps, images, psnr_db;  ///< psnr_db: on held-out frames
};
constexpr MeasuredRun kMeasuredRuns[] = {
    {true, "a made street, true poses", 1527, 168, 30.7},
    {true, "a made street, true poses", 8896, 168, 31.7},
    {true, "a night drive at half size", 2051, 172, 29.2},
    {true, "a street of KITTI at full size", 4000, 21, 22.8},
    {false, "photographs of a toy (fox)", 3000, 43, 30.6},
    {false, "photographs of a door", 3000, 10, 31.5},
    {false, "renderings of an object", 3740, 100, 36.5},
};

/// Prints steps and preparation of the longest block, and scores of measured runs of its kind.
void print_steps(bool metric, const TrainingPlan& plan, const std::string& method) {
  const PlannedBlock& block =
      *std::ranges::max_element(plan.blocks, {}, [](const PlannedBlock& b) { return b.seconds(); });
  const double each = block.steps / static_cast<double>(std::max<std::int64_t>(block.images, 1));
  std::printf("training   %s of preparation, then %.0f steps in %s: %.1f an image%s\n",
              time_text(block.prepare_s).c_str(), block.steps, time_text(block.train_s).c_str(),
              each, plan.blocks.size() > 1 ? ", in the longest block" : "");
  if (method != kDefaultMethod) return;
  std::printf("quality    not predicted; held-out PSNR of measured runs:\n");
  for (const MeasuredRun& run : kMeasuredRuns)
    if (run.metric == metric)
      std::printf("           %.1f dB, %s, %.0f steps an image\n", run.psnr_db, run.what,
                  run.steps / run.images);
}

void print(const Scene& scene, const TrainingPlan& plan, const TrainingRates& rates,
           const Machines& machines, const std::string& method) {
  std::int64_t images = 0;
  for (const View& view : scene.views) images += !view.held_out;
  if (scene.metric)
    std::printf("drive      %s over %.0f m, %s, %lld images for training\n",
                counted(scene.frames.size(), "frame").c_str(),
                way_driven(scene.posed_frames()).back(),
                counted(scene.rig.size(), "camera").c_str(), static_cast<long long>(images));
  else
    std::printf("photos     %lld images for training\n", static_cast<long long>(images));
  double length_m = 0, longest_s = 0;
  std::int64_t most = 0;
  std::size_t streamed = 0;
  for (const PlannedBlock& block : plan.blocks) {
    length_m = std::max(length_m, block.length_m);
    longest_s = std::max(longest_s, block.seconds());
    most = std::max(most, block.images);
    streamed += block.streams;
  }
  if (plan.blocks.size() > 1)
    std::printf(
        "blocks     %zu of at most %.0f m, %lld images and %s; %zu decode images as needed\n",
        plan.blocks.size(), length_m, static_cast<long long>(most), time_text(longest_s).c_str(),
        streamed);
  std::printf(
      "rates      one core here: %.1f ms to decode an image, %.1f ms to prepare and %.1f ms to "
      "begin with it, %.1f ms a step; its speed changed by %.0f %% meanwhile, corrected\n",
      1e3 * rates.decode_s, 1e3 * rates.prepare_s, 1e3 * rates.start_s, 1e3 * rates.step_s,
      100 * (rates.spread - 1));
  const auto count = [](int n, const char* noun) {
    return counted(static_cast<std::size_t>(n), noun);
  };
  std::printf("machines   %d with %s and %s each: %s at once with %s each\n", machines.machines,
              count(machines.cores, "core").c_str(), gib_text(machines.memory).c_str(),
              count(plan.ranks_per_machine, "block").c_str(),
              count(plan.cores_per_rank, "core").c_str());
  std::printf("time       %s; %.1f core hours; efficiency %.0f %%, limited by %s\n",
              time_text(plan.seconds).c_str(), plan.core_seconds / 3600, 100 * plan.efficiency,
              plan.limit.c_str());
  print_steps(scene.metric, plan, method);
  std::printf("memory     %s a machine\n", gib_text(plan.memory_bytes).c_str());
  std::printf("disk       %s written, %s read\n",
              bytes_text(static_cast<double>(plan.writes_bytes)).c_str(),
              bytes_text(static_cast<double>(plan.reads_bytes)).c_str());
  std::printf("traffic    at most %s/s from the recording, all machines together\n",
              bytes_text(plan.reads_bytes_per_s).c_str());
}

int run_plan(const PlanArguments& arguments) {
  TrainOptions options = options_of(arguments);
  const auto owned = make_backend(options);
  kernels::Backend& backend = *owned;
  Recording recording = open_recording(options);
  resolve_cameras(&options, &recording);
  const Scene scene = make_scene(recording, scene_options(options));
  if (!arguments.blocks.empty()) check_divisible(arguments.blocks, options, recording);
  Machines machines{arguments.machines, arguments.cores > 0 ? arguments.cores : backend.threads(),
                    allowed_memory(options, memory_bytes())};

  const std::vector<Block> blocks =
      divide_as_told(arguments.blocks.empty() ? "1e9" : arguments.blocks,
                     {.options = options, .recording = recording, .scene = scene},
                     {machines.cores, machines.memory});
  const TrainingRates rates = measured(options, recording, blocks[blocks.size() / 2], backend);
  const auto planned_with = [&](int threads) {
    std::vector<PlannedBlock> facts;
    for (const Block& block : blocks)
      facts.push_back(planned(
          block, run_of(blocks.size() > 1 ? block_options(options, block) : options, recording),
          threads));
    return plan_training(std::move(facts), rates, machines,
                         {options.max_steps, options.max_seconds, options.checkpoint_every});
  };
  // A rank's memory depends on its threads, and their number on how many ranks have memory.
  const int n = static_cast<int>(blocks.size()),
            at_once = std::min(machines.cores, (n + machines.machines - 1) / machines.machines);
  int threads = machines.cores / at_once;
  TrainingPlan plan = planned_with(threads);
  while (plan.cores_per_rank > threads) plan = planned_with(threads = plan.cores_per_rank);
  if (!arguments.json) {
    print_notes(recording, scene);
    print(scene, plan, rates, machines, options.method);
    return kExitOk;
  }
  nlohmann::json json = to_json(plan);
  json["recording"] = options.recording;
  json["method"] = options.method;
  json["frames"] = scene.frames.size();
  json["length_m"] = way_driven(scene.posed_frames()).back();
  json["machines"] = {{"machines", machines.machines},
                      {"cores", machines.cores},
                      {"memory_bytes", machines.memory}};
  json["core_rates"] = {{"decode_s", rates.decode_s}, {"prepare_s", rates.prepare_s},
                        {"start_s", rates.start_s},   {"mask_s", rates.mask_s},
                        {"look_s", rates.look_s},     {"step_s", rates.step_s},
                        {"spread", rates.spread}};
  print_json(json);
  return kExitOk;
}

}  // namespace

Action configure_plan(CLI::App& command) {
  auto arguments = std::make_shared<PlanArguments>();
  command.add_option("RECORDING", arguments->recording, "as for train")->required();
  for (const TrainField& field : train_fields())
    if (std::ranges::find(kPlannedOptions, field.name) != std::end(kPlannedOptions))
      add_field(command, field, &arguments->given);
  command.add_option("--blocks", arguments->blocks,
                     "metres of a block, or auto, as for train (default: one block)");
  command.add_option("--machines", arguments->machines, "number of machines, 1..100000")
      ->check(within("--machines", 1, 100'000))
      ->capture_default_str();
  command
      .add_option("--cores", arguments->cores,
                  "cores of each machine, 1..4096 (default: those of --threads here)")
      ->check(within("--cores", 1, 4096));
  add_json_option(command, &arguments->json);
  return [arguments] { return run_plan(*arguments); };
}

}  // namespace redrive
