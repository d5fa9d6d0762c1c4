// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/plan.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <optional>
#include <queue>

#include <nlohmann/json.hpp>

#include "redrive/base/core_time.h"
#include "redrive/base/error.h"
#include "redrive/perception/masks.h"
#include "redrive/perception/seen_through.h"
#include "redrive/rays/lidar_sampler.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/memory.h"
#include "redrive/train/step.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

constexpr double kLooksTaken = 0.6;  // share of search_looks: most points stay in place

/// Measures work on a machine whose speed changes: the same reference work is done before and after
/// each part, and the part's time is divided by its slowness.
class PacedClock {
 public:
  explicit PacedClock(std::function<void()> pace) : pace_(std::move(pace)) {
    pace_();  // allocates, and reads files
    const CoreTimer timer;
    pace_();
    repetitions_ = 1 + static_cast<int>(kPace_s / std::max(timer.core_seconds(1), 1e-4));
    measure_pace();
  }

  /// Returns the index of the work's core seconds in seconds().
  std::size_t measure(int cores, const std::function<void()>& work) {
    const CoreTimer timer;
    work();
    parts_.push_back({timer.core_seconds(cores), paces_.size()});
    measure_pace();
    return parts_.size() - 1;
  }

  /// Core seconds of a part at the machine's median pace.
  double seconds(std::size_t part) const {
    const auto [seconds, after] = parts_[part];
    std::vector<double> paces = paces_;
    const auto median = paces.begin() + std::ssize(paces) / 2;
    std::nth_element(paces.begin(), median, paces.end());
    return seconds * 2 * *median / (paces_[after - 1] + paces_[after]);
  }
  double spread() const {
    return *std::ranges::max_element(paces_) / *std::ranges::min_element(paces_);
  }

 private:
  struct Part {
    double seconds = 0;
    std::size_t after = 0;  ///< index of the pace
  };

  static constexpr double kPace_s = 0.01;  // cold caches and timers hardly matter after it

  /// Takes the least of three counts: an interrupted one means nothing.
  void measure_pace() {
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i < 3; ++i) {
      const CoreTimer timer;
      for (int k = 0; k < repetitions_; ++k) pace_();
      least = std::min(least, timer.core_seconds(1));
    }
    paces_.push_back(least);
  }

  std::function<void()> pace_;
  int repetitions_ = 1;
  std::vector<double> paces_;
  std::vector<Part> parts_;
};

TrainingSet training_set(const Run& run, const TrainingData& data, const PixelSampler& sampler,
                         const LidarSampler& lidar) {
  return {run.scene, data.view_images(), data.lidar, sampler,
          data.lidar.n > 0 && run.state.model->uses_lidar() ? &lidar : nullptr};
}

/// What a trainer does before its first step.
void begin_from(const TrainingData& data, ThreadPool& pool, Run* run, StepBuffers* buffers) {
  const PixelSampler sampler(run->scene, data.images, run->options.seed);
  const LidarSampler lidar(data.lidar, run->scene, run->options.seed);
  const TrainingSet set = training_set(*run, data, sampler, lidar);
  Trainee& model = *run->state.model;
  model.initialize_from(set, run->state.seed, pool);
  model.prepare(set, pool, buffers);
}

double training_images(const Scene& scene) {
  return static_cast<double>(std::ranges::count(scene.views, false, &View::held_out));
}

/// Core seconds to find the static mask of the rig's first camera.
double measure_mask(const Scene& scene, ThreadPool& pool) {
  Scene one = scene;
  std::erase_if(one.views, [](const View& view) { return view.camera != 0 || view.held_out; });
  const std::size_t n = std::min(one.views.size(), kMostMaskViews);
  for (std::size_t i = 0; i < n; ++i) one.views[i] = one.views[i * one.views.size() / n];
  one.views.resize(n);
  const std::vector<Image8> images = load_views(one, pool);
  const CoreTimer timer;
  find_static_mask(one, 0, images, /*on_car=*/true);
  return timer.core_seconds(1);
}

/// Core seconds for a look of the search for moving objects: between two revolutions of LiDAR that
/// are so far apart that they look at each other, beyond what each of them takes alone.
double measure_look(Run* run, ThreadPool& pool) {
  constexpr double kApart_s = 0.5;
  const std::vector<FrameFile> files = run->recording.scans_of(0);
  const auto middle = std::ssize(files) / 2;
  const double drive_s =
      1e-9 * static_cast<double>(run->scene.frames.back().t_ns - run->scene.frames.front().t_ns);
  const auto apart =
      std::lround(kApart_s * static_cast<double>(std::ssize(files) - 1) / std::max(drive_s, 1e-3));
  if (apart < 1 || middle + apart >= std::ssize(files)) return 0;
  const auto search = [&](std::vector<FrameFile> of) {
    run->recording.lidar_files = std::move(of);
    const CoreTimer timer;
    find_moving(*run, pool);
    return timer.core_seconds(pool.threads());
  };
  const double alone_s = search({files[middle]}),
               both_s = search({files[middle], files[middle + apart]});
  return std::max(0.0, (both_s - 2 * alone_s) / 2);
}

/// Steps as a clock measured them.
struct MeasuredSteps {
  std::vector<std::size_t> parts;    ///< steps between changes of the number of parameters
  std::vector<std::size_t> changes;  ///< steps that end with such a change
  int others = 0;                    ///< number of steps in `parts`

  /// Returns the seconds of a step of the run, which has fewer changes than its calibration.
  double seconds_each(const PacedClock& clock, const CalibrationSteps& calibration) const {
    double step_s = 0, beyond_s = 0;
    for (const std::size_t part : parts) step_s += clock.seconds(part) / std::max(others, 1);
    for (const std::size_t part : changes) beyond_s += clock.seconds(part) - step_s;
    const auto steps = static_cast<double>(others) + static_cast<double>(changes.size());
    return step_s + std::max(0.0, beyond_s) / steps * calibration.change_every /
                        calibration.change_every_of_run;
  }
};

}  // namespace

void measure_left_out(const TrainOptions& options, const Recording& recording, const Scene& scene,
                      kernels::Backend& backend, TrainingRates* rates) {
  if (options.masks == "none" || !recording.metric) return;
  ThreadPool pool(backend.threads());
  if (options.masks == "auto") rates->mask_s = measure_mask(scene, pool);
  Run run;
  run.options = options;
  run.recording = recording;
  run.scene = scene;
  rates->look_s = measure_look(&run, pool);
}

TrainingRates measure_rates(Run* run, kernels::Backend& backend,
                            const CalibrationSteps& calibration, Run* fewer) {
  constexpr int kDecoded = 8;
  TrainingRates rates;
  ThreadPool& pool = backend.pool();
  Trainee& model = *run->state.model;
  std::vector<const View*> views;
  for (const View& view : run->scene.views)
    if (!view.held_out) views.push_back(&view);
  const double images = training_images(run->scene);
  const int cores = pool.threads();

  DamagedViews damaged;
  const ViewLoader load(run->scene, pool, &damaged);
  PacedClock clock([&] { load(*views.front()); });
  const std::size_t decoded = std::min<std::size_t>(views.size(), kDecoded);
  const std::size_t decode = clock.measure(1, [&] {
    for (std::size_t i = 0; i < decoded; ++i) load(*views[i * views.size() / decoded]);
  });
  std::optional<TrainingData> data;
  const std::size_t prepare =
      clock.measure(cores, [&] { data.emplace(prepare_training_data(run, pool)); });
  StepBuffers buffers;
  const std::size_t start = clock.measure(cores, [&] { begin_from(*data, pool, run, &buffers); });
  std::optional<std::size_t> fewer_start;
  if (fewer) {
    StepBuffers unused;
    const TrainingData part = prepare_training_data(fewer, pool);
    fewer_start = clock.measure(cores, [&] { begin_from(part, pool, fewer, &unused); });
  }
  const PixelSampler sampler(run->scene, data->images, run->options.seed);
  const LidarSampler lidar(data->lidar, run->scene, run->options.seed);
  const TrainingSet set = training_set(*run, *data, sampler, lidar);
  TrainState& state = run->state;
  state.adam = model.zero_moments();
  if (model.uses_error_map()) {
    state.cell_errors = Buffer<float>(sampler.cells().size());
    std::ranges::fill(state.cell_errors.span(), kInitialError);
  }
  const auto train_at = [&](double progress, int steps) {
    StepRequest request = next_step(state);
    request.progress = progress;
    const double rate = model.learning_rate({state.step, steps, request.progress});
    train_step(backend, set, request, rate, &state, &buffers);
  };
  train_at(0, 1);  // allocates
  const CoreTimer last_timer;
  train_at(1, 1);  // one step at full size, of the longest kind
  constexpr double kSteps_s = 4;
  const int steps = std::min(calibration.steps,
                             std::max(CalibrationSteps::kLeast,
                                      static_cast<int>(kSteps_s / last_timer.core_seconds(cores))));
  const auto step = [&](int i) { train_at(static_cast<double>(i) / steps, steps); };
  // Steps that end with a change of the number of parameters are measured one by one.
  MeasuredSteps measured;
  for (int i = 0; i < steps;) {
    const int change = static_cast<int>((state.step / calibration.change_every + 1) *
                                            calibration.change_every -
                                        1 - state.step),
              n = std::clamp(change, 1, steps - i);
    (change == 0 ? measured.changes : measured.parts).push_back(clock.measure(cores, [&] {
      for (int k = i; k < i + n; ++k) step(k);
    }));
    if (change > 0) measured.others += n;
    i += n;
  }
  rates.step_s = measured.seconds_each(clock, calibration);
  rates.decode_s = clock.seconds(decode) / static_cast<double>(decoded);
  rates.prepare_s = clock.seconds(prepare) / images;
  rates.start_s = clock.seconds(start) / images;
  if (fewer)
    if (const double more = images - training_images(fewer->scene); more > 0)
      rates.start_s =
          std::max(rates.start_s, (clock.seconds(start) - clock.seconds(*fewer_start)) / more);
  rates.spread = clock.spread();
  return rates;
}

double queue_seconds(std::vector<double> tasks, int ranks) {
  REDRIVE_CHECK_OP(ranks, >=, 1);
  std::ranges::sort(tasks, std::greater<>());
  std::priority_queue<double, std::vector<double>, std::greater<>> free_at;
  for (int rank = 0; rank < ranks; ++rank) free_at.push(0);
  double end = 0;
  for (const double task : tasks) {
    const double done = free_at.top() + task;
    free_at.pop();
    free_at.push(done);
    end = std::max(end, done);
  }
  return end;
}

namespace {

/// Chooses how many ranks share a machine's cores and memory.
void share_machines(const std::vector<PlannedBlock>& blocks, const Machines& machines,
                    TrainingPlan* plan) {
  std::uint64_t largest = 0, least = 0;
  for (const PlannedBlock& block : blocks) {
    largest = std::max(largest, block.memory_bytes);
    least = std::max(least, block.least_memory_bytes);
  }
  if (least > machines.memory)
    throw UsageError("--memory", gib_text(machines.memory),
                     "is less than the " + gib_text(least) +
                         " that the largest block needs; --blocks of fewer metres, or --downscale");
  const auto n = static_cast<int>(blocks.size());
  const auto fit = static_cast<int>(std::clamp<std::uint64_t>(machines.memory / largest, 1, 4096));
  plan->ranks_per_machine =
      std::min({machines.cores, (n + machines.machines - 1) / machines.machines, fit});
  plan->cores_per_rank = std::max(1, machines.cores / plan->ranks_per_machine);
}

}  // namespace

TrainingPlan plan_training(std::vector<PlannedBlock> blocks, const TrainingRates& rates,
                           const Machines& machines, const TrainingLimits& limits) {
  REDRIVE_CHECK(!blocks.empty());
  REDRIVE_CHECK(limits.max_steps > 0 || limits.max_seconds > 0);
  TrainingPlan plan;
  share_machines(blocks, machines, &plan);
  const double cores = plan.cores_per_rank;
  const std::uint64_t memory = machines.memory / static_cast<std::uint64_t>(plan.ranks_per_machine);
  const int ranks = plan.ranks_per_machine * machines.machines;

  std::vector<double> tasks, reads_per_s;
  double longest = 0, sum = 0;
  bool decoding_limits = false;
  for (PlannedBlock& block : blocks) {
    block.streams = block.memory_bytes > memory;
    const auto images = static_cast<double>(block.images);
    const double again = block.streams ? images * rates.decode_s * (kStreamedPasses - 1) : 0,
                 start_s = (images * rates.start_s + again) / cores;
    // The part of the steps whose image is not in the cache.
    const double missing =
        block.streams ? 1 - static_cast<double>(memory) / static_cast<double>(block.memory_bytes)
                      : 0;
    const double decode_s = missing * rates.decode_s / image_decoders(plan.cores_per_rank),
                 step_s =
                     std::max(rates.step_s / cores + missing * rates.decode_s / cores, decode_s);
    decoding_limits |= decode_s >= step_s;
    const double read_s = images * rates.prepare_s / cores,
                 left_out_s = (static_cast<double>(block.cameras) * rates.mask_s +
                               kLooksTaken * static_cast<double>(search_looks(block.sweeps)) *
                                   rates.look_s) /
                              cores;
    block.prepare_s = read_s + left_out_s + start_s;
    block.train_s = static_cast<double>(limits.max_steps) * step_s;
    if (limits.max_seconds > 0)
      block.train_s =
          limits.max_steps > 0 ? std::min(block.train_s, limits.max_seconds) : limits.max_seconds;
    block.steps = block.train_s / step_s;
    const double steps = block.steps,
                 file = static_cast<double>(block.image_file_bytes) / std::max(images, 1.0),
                 reads = static_cast<double>(block.image_file_bytes) *
                             (block.streams ? kStreamedPasses : 1) +
                         static_cast<double>(block.lidar_file_bytes) + steps * missing * file;
    block.reads_bytes = static_cast<std::uint64_t>(reads);
    plan.reads_bytes += block.reads_bytes;
    // At the start, on the way and at the end.
    const double checkpoints = 2 + std::floor(std::max(steps / limits.checkpoint_every,
                                                       block.train_s / kSecondsPerCheckpoint));
    plan.writes_bytes += static_cast<std::uint64_t>(checkpoints) * block.checkpoint_bytes;
    plan.memory_bytes = std::max(plan.memory_bytes, std::min(block.memory_bytes, memory));
    tasks.push_back(block.seconds());
    reads_per_s.push_back(std::max((static_cast<double>(block.image_file_bytes) +
                                    static_cast<double>(block.lidar_file_bytes)) /
                                       std::max(read_s, 1e-9),
                                   missing * file / step_s));
    longest = std::max(longest, block.seconds());
    sum += block.seconds();
  }
  plan.memory_bytes *= static_cast<std::uint64_t>(plan.ranks_per_machine);
  plan.seconds = queue_seconds(tasks, ranks);
  plan.core_seconds = sum * cores;
  plan.efficiency = sum / (plan.seconds * ranks);
  std::ranges::sort(reads_per_s, std::greater<>());
  reads_per_s.resize(std::min<std::size_t>(reads_per_s.size(), static_cast<std::size_t>(ranks)));
  for (const double rate : reads_per_s) plan.reads_bytes_per_s += rate;
  plan.limit = decoding_limits                  ? "decoding of images"
               : longest > 0.999 * plan.seconds ? "the longest block"
                                                : "the number of cores";
  plan.blocks = std::move(blocks);
  return plan;
}

nlohmann::json to_json(const TrainingPlan& plan) {
  nlohmann::json blocks = nlohmann::json::array();
  for (const PlannedBlock& block : plan.blocks)
    blocks.push_back({{"name", block.name},
                      {"first_frame", block.first_frame},
                      {"last_frame", block.last_frame},
                      {"length_m", block.length_m},
                      {"images", block.images},
                      {"memory_bytes", block.memory_bytes},
                      {"least_memory_bytes", block.least_memory_bytes},
                      {"streams", block.streams},
                      {"prepare_s", block.prepare_s},
                      {"train_s", block.train_s},
                      {"steps", block.steps},
                      {"reads_bytes", block.reads_bytes},
                      {"checkpoint_bytes", block.checkpoint_bytes}});
  return {{"ranks_per_machine", plan.ranks_per_machine},
          {"cores_per_rank", plan.cores_per_rank},
          {"seconds", plan.seconds},
          {"core_seconds", plan.core_seconds},
          {"efficiency", plan.efficiency},
          {"memory_bytes", plan.memory_bytes},
          {"reads_bytes", plan.reads_bytes},
          {"reads_bytes_per_s", plan.reads_bytes_per_s},
          {"writes_bytes", plan.writes_bytes},
          {"limit", plan.limit},
          {"blocks", std::move(blocks)}};
}

}  // namespace redrive
