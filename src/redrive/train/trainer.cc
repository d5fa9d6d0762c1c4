// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/trainer.h"

#include <malloc.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <limits>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"
#include "redrive/base/rng.h"
#include "redrive/rays/lidar_sampler.h"
#include "redrive/recording/core/wording.h"
#include "redrive/train/distributed/data_parallel.h"
#include "redrive/train/loss_watch.h"
#include "redrive/train/poses/pose_refiner.h"
#include "redrive/train/progress.h"
#include "redrive/train/start_watch.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

/// Returns what preparation has freed to the system. One thread at a time: where another allocator
/// stands in for glibc's, as a sanitizer's does, the first call sets glibc's up, without a lock.
void trim_memory() {
  static std::mutex one_at_a_time;
  const std::lock_guard lock(one_at_a_time);
  malloc_trim(0);
}

constexpr int kStepsPerRow =
    25;  // per row of metrics.jsonl: 25 x 1024 rays average out the noise of a batch
constexpr int kMaxBadSteps = 50;  // consecutive non-finite steps before a roll-back

double seconds_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

double decibels(double mse) { return -10 * std::log10(std::max(mse, 1e-10)); }

/// State of one call of train().
class Trainer {
 public:
  Trainer(Run* run, const TrainingData& data, kernels::Backend& backend, StepObserver* observer,
          ProcessGroup* processes)
      : run_(*run),
        backend_(backend),
        processes_(processes),
        writes_(!processes || processes->rank() == 0),
        observer_(observer),
        state_(run->state),
        options_(run->options),
        sampler_(data.sampler(run->scene, run->options.seed)),
        lidar_sampler_(data.lidar, run->scene, run->options.seed),
        data_{run->scene, data.view_images(), data.lidar, sampler_,
              data.lidar.n > 0 && run->state.model->uses_lidar() ? &lidar_sampler_ : nullptr},
        refinement_(pose_refinement(run->options)),
        saved_seconds_(run->state.seconds) {
    run_.scene.correct({});
    if (state_.step == 0) begin_from_data();
    state_.model->prepare(data_, backend_.pool(), &buffers_);
    steps_per_epoch_ = state_.model->steps_per_epoch(data_, processes ? processes->size() : 1);
    steps_ = total_steps(options_, steps_per_epoch_);
    check_same_begin();
    adapt_state();
    trim_memory();
  }

  ~Trainer() { run_.scene.correct({}); }
  Trainer(const Trainer&) = delete;
  Trainer& operator=(const Trainer&) = delete;

  TrainEnd run(const std::atomic<bool>& stop) {
    if (writes_) truncate_metrics(run_.paths, {state_.restarts, state_.rollbacks, state_.step});
    print_schedule();
    if (state_.step == 0) save();
    Progress shown("training");
    progress_ = &shown;
    waited_s_ = row_waited_s_ = data_.images.statistics().waited_s;
    while (true) {
      while (progress() < 1) {
        if (asked_to(stop)) return end(TrainEnd::kInterrupted);
        if (state_.step == 0 && !train_first(stop)) return TrainEnd::kInterrupted;
        step();
        if (observer_) observer_->between_steps(run_);
      }
      if (state_.window.steps > 0) close_window(state_.step);
      if (!loss_rose()) {
        REDRIVE_CHECK_OP(state_.step, >, 0);  // or the run would look trained
        finish_training();
        return end(TrainEnd::kFinished);
      }
      roll_back(high_loss());
    }
  }

 private:
  double learning_rate(std::int64_t step) const {
    return state_.rate_factor * state_.model->learning_rate({step, steps_, progress()});
  }

  /// --learning-rate, for messages.
  std::string initial_rate() const {
    for (const HyperparameterValue& value : hyperparameter_values(*state_.model))
      if (value.what.option == "learning-rate") return value.text;
    return "";
  }

  double pose_rate() const {
    return refinement_.first_rate_m * std::pow(refinement_.last_rate, progress());
  }

  double progress() const { return run_progress(options_, state_); }

  /// Initialises parameters from the data, with fresh moments.
  void begin_from_data() {
    if (!data_.lidar.scan_ends.empty()) {
      state_.lidar_gains.clear();
      for (const LidarReturns::Sensor& sensor : data_.lidar.sensors)
        state_.lidar_gains.push_back({sensor.gain, sensor.beam_gains, sensor.blind});
      set_gains(state_.lidar_gains, run_.paths.checkpoint(), &run_.recording);
    }
    Trainee& model = *state_.model;
    const Progress progress("preparing the first parameters");
    run_.scene.correct({});
    model.initialize_from(data_, state_.seed, backend_.pool());
    if (state_.adam.size() != model.size()) state_.adam = model.zero_moments();
  }

  /// Trains on what comes before images. Where that is interrupted, the checkpoint of step 0
  /// stands.
  bool train_first(const std::atomic<bool>& stop) {
    const Progress progress("training on LiDAR scans");
    const auto begin = std::chrono::steady_clock::now();
    const bool done = state_.model->train_first(backend_, data_, state_.seed, &state_.adam,
                                                [&] { return !asked_to(stop); });
    if (!done) state_ = last_saved();
    state_.seconds += of_processes(seconds_since(begin)).front();
    return done;
  }

  void finish_training() {
    const Progress progress("filling what moving objects hide");
    const auto begin = std::chrono::steady_clock::now();
    take_mean(backend_, &state_);
    state_.model->fetch(backend_);
    state_.model->finish_training(backend_, data_, &state_.adam);
    state_.seconds += of_processes(seconds_since(begin)).front();
  }

  /// Returns a number of each process.
  std::vector<double> of_processes(double own) const {
    std::vector<double> all(processes_ ? static_cast<std::size_t>(processes_->size()) : 1, own);
    if (processes_) processes_->all_gather({&own, 1}, all);
    return all;
  }

  /// Whether any process was asked to stop.
  bool asked_to(const std::atomic<bool>& stop) const {
    return std::ranges::max(of_processes(stop ? 1 : 0)) > 0;
  }

  /// Checks that all processes begin with the same state and options, and sets the clock of
  /// process 0.
  void check_same_begin() {
    if (!processes_) return;
    nlohmann::json options = options_to_json(options_);
    for (const char* own : {"threads", "memory", "gpu-memory"}) options.erase(own);
    std::uint64_t hash = std::hash<std::string>()(options.dump() + kernels::identity(backend_));
    for (const std::uint64_t number : {state_.seed, static_cast<std::uint64_t>(state_.step),
                                       static_cast<std::uint64_t>(sampler_.pixels())})
      hash = mix64(hash ^ number);
    for (const Buffer<float>* numbers :
         {&state_.model->parameters, &state_.mean.values, &state_.adam.first_moment,
          &state_.adam.second_moment, &state_.adam.errors})
      for (const float number : numbers->span())
        hash = mix64(hash ^ std::bit_cast<std::uint32_t>(number));
    for (const std::uint32_t packed : state_.adam.packed.span()) hash = mix64(hash ^ packed);
    const std::vector<double> hashes = of_processes(static_cast<double>(hash >> 12));  // exact
    if (std::ranges::count(hashes, hashes.front()) != std::ssize(hashes))
      throw UsageError(
          "mpirun", std::to_string(hashes.size()) + " processes",
          "begin with different options, parameters, moments or pixels: they need the same files, "
          "processors with the same instruction sets or one --isa, GPUs of one model and driver, "
          "and the same program");
    state_.seconds = of_processes(state_.seconds).front();
  }

  /// Adapts the state to the pixels, which differ from before after masks were edited or when it is
  /// fresh.
  void adapt_state() {
    state_.pixels = sampler_.pixels();
    const std::size_t cells = state_.model->uses_error_map() ? sampler_.cells().size() : 0;
    if (state_.cell_errors.size() != cells) {
      state_.cell_errors = Buffer<float>(cells);
      std::ranges::fill(state_.cell_errors.span(), kInitialError);
    }
    update_poses();
  }

  /// Applies the pose corrections to the scene, and to the sampler if the model draws from it.
  void update_poses() {
    if (!state_.poses.refines()) return;
    run_.scene.correct(state_.poses.corrections);
    if (!state_.model->streams_images()) sampler_.update_poses();
  }

  bool refines() const {
    return state_.poses.refines() && state_.step % refinement_.steps_per_update == 0 &&
           progress() > refinement_.start;
  }

  void step() {
    const auto begin = std::chrono::steady_clock::now();
    const std::int64_t number = state_.step;
    StepRequest request = next_step(state_);
    request.progress = progress_before_ = progress();
    request.pose_gradients = refines();
    request.colour_variance = watches_colours(number);
    const StepResult result = train_step({backend_, processes_}, data_, request,
                                         learning_rate(number), &state_, &buffers_);
    if (request.pose_gradients && result.finite) {
      refine_poses(run_.scene, result.views, pose_rates(pose_rate()), refinement_, &state_.poses);
      update_poses();
    }
    const double seconds = of_processes(seconds_since(begin)).front();
    state_.seconds += seconds;

    if (!begin_conditions(conditions(result.stage), number)) return roll_back(high_loss());
    if (const auto reason = watch_start(result, number, &state_.watch)) return restart(*reason);
    if (!result.finite) return skip();
    if (result.left_out_tracks > 0)
      std::fprintf(stderr, "redrive: step %lld: gradients of %s are not finite; left out\n",
                   static_cast<long long>(state_.step),
                   counted(static_cast<std::size_t>(result.left_out_tracks), "track").c_str());
    state_.bad_steps = 0;
    LossWindow& window = state_.window;
    ++window.steps;
    window.rays += result.pixels;
    window.loss += result.loss;
    window.mse += result.rgb_mse;
    for (std::size_t i = 0; i < result.loss_terms.size(); ++i)
      window.terms[i] += result.loss_terms[i].value;
    window.seconds += seconds;
    show_progress();
    if (state_.step % kStepsPerRow == 0) close_window(state_.step);
    if (has_diverged(state_.loss_watch)) return roll_back(high_loss());
    save_due_ |= state_.step % options_.checkpoint_every == 0 ||
                 state_.seconds - saved_seconds_ >= kSecondsPerCheckpoint;
    // A checkpoint must be a state to roll back to. The last one is written when all is done.
    if (save_due_ && progress() < 1 && !loss_rose()) save();
  }

  void save() {
    saved_seconds_ = state_.seconds;
    save_due_ = false;
    state_.model->fetch(backend_);
    if (!writes_) return;
    sync_metrics(run_.paths);
    state_.device = kernels::identity(backend_);
    save_checkpoint(run_.paths.checkpoint(), state_);
  }

  /// Returns the state of the last checkpoint. Frees the memory of the current one for it.
  TrainState last_saved() {
    state_.model->fetch(backend_);
    state_.model->parameters = {};
    state_.adam = {};
    state_.mean = {};
    return load_checkpoint(run_.paths.checkpoint());
  }

  bool loss_rose() const { return last_was_high_ || is_high(watched(), state_.loss_watch); }

  /// Returns the window with the independent windows of its rays.
  LossWindow watched() const {
    LossWindow window = state_.window;
    window.rays = state_.model->independent_pixels(window.rays);
    return window;
  }

  /// Restarts the run from another seed after a start that failed.
  void restart(const std::string& reason) {
    if (state_.restarts == kMaxRestarts)
      throw UsageError("--learning-rate", initial_rate(),
                       "no start out of " + std::to_string(kMaxRestarts + 1) + " converged (" +
                           reason + "); try a lower rate");
    const int restarts = state_.restarts + 1;
    state_.model->fetch(backend_);
    TrainState fresh = initial_state(std::move(state_.model),
                                     mix64(options_.seed + static_cast<std::uint64_t>(restarts)));
    if (state_.poses.refines()) fresh.poses = PoseState(run_.scene);
    fresh.restarts = restarts;
    fresh.seconds = state_.seconds;
    std::fprintf(stderr,
                 "redrive: step %lld: %s; restarting from another seed (%d of at most %d)\n",
                 static_cast<long long>(state_.step), reason.c_str(), restarts, kMaxRestarts);
    if (writes_) append_restart(run_.paths, state_.step, restarts, fresh.seed, reason);
    state_ = std::move(fresh);
    begin_from_data();
    check_same_begin();
    adapt_state();
    last_was_high_ = false;
    save();
  }

  /// Counts a non-finite step after the start; the parameters are unchanged.
  void skip() {
    ++state_.skipped_steps;
    ++state_.bad_steps;
    std::fprintf(stderr,
                 "redrive: step %lld: loss or gradients are not finite; skipped (%lld so far)\n",
                 static_cast<long long>(state_.step), static_cast<long long>(state_.skipped_steps));
    if (state_.bad_steps >= kMaxBadSteps)
      roll_back(std::to_string(kMaxBadSteps) + " steps on end were not finite");
  }

  std::string high_loss() const {
    char text[120];
    std::snprintf(text, sizeof text, "diverging: mean squared error %.3g, it was %.3g before",
                  state_.loss_watch.smoothed, state_.loss_watch.best);
    return text;
  }

  /// Goes back to the last checkpoint, at a lower learning rate.
  void roll_back(const std::string& reason) {
    if (state_.rollbacks == kMaxRollbacks)
      throw UsageError("--learning-rate", initial_rate(),
                       reason + ", as " + std::to_string(kMaxRollbacks) +
                           " times before at higher rates than " +
                           std::to_string(state_.rate_factor) + " of it; the last good state is " +
                           run_.paths.checkpoint().string() + "; try a lower rate");
    TrainState good = last_saved();
    good.seconds = state_.seconds;
    good.skipped_steps = state_.skipped_steps;
    good.rollbacks = state_.rollbacks + 1;
    good.rate_factor = kRollbackRate * state_.rate_factor;
    std::fprintf(stderr,
                 "redrive: step %lld: %s; back to step %lld at %g of the learning rate (%d of at "
                 "most %d times)\n",
                 static_cast<long long>(state_.step), reason.c_str(),
                 static_cast<long long>(good.step), good.rate_factor, good.rollbacks,
                 kMaxRollbacks);
    if (writes_)
      append_rollback(run_.paths, state_.step, good.step, good.rollbacks, good.rate_factor, reason);
    state_ = std::move(good);
    adapt_state();
    last_was_high_ = false;
    save();
  }

  /// Returns a hash of the conditions under which errors are comparable.
  std::uint64_t conditions(int stage) const {
    const bool moves = state_.poses.refines() && progress_before_ > refinement_.start;
    std::uint64_t hash = sampler_.pixels();
    for (const int number : {processes_ ? processes_->size() : 1, stage, moves ? 1 : 0})
      hash = mix64(hash ^ static_cast<std::uint64_t>(number));
    return hash;
  }

  /// Begins a new reference of the loss if the conditions changed after `steps` steps. Returns
  /// false if the loss was high by then: it must not become the reference.
  bool begin_conditions(std::uint64_t now, std::int64_t steps) {
    if (now == state_.loss_watch.conditions) return true;
    if (state_.window.steps > 0) close_window(steps);
    if (loss_rose()) return false;
    state_.loss_watch = {now};
    return true;
  }

  /// Writes the row of metrics.jsonl that ends at `step`.
  void close_window(std::int64_t step) {
    const LossWindow& window = state_.window;
    if (window.steps > 0) {
      MetricsRow row;
      row.step = step;
      row.seconds = state_.seconds;
      row.loss = window.loss / window.steps;
      row.psnr_db = decibels(window.mse / window.steps);
      row.learning_rate = learning_rate(step - 1);
      row.rays_per_s = rays_per_second();
      row.epoch = static_cast<int>((state_.pixels_drawn - 1) / sampler_.pixels());
      std::size_t i = 0;
      for (const LossTerm& term : state_.model->loss_terms({}))
        row.losses.emplace_back(term.name, window.terms[i++] / window.steps);
      const double waited_s = data_.images.statistics().waited_s;
      row.image_wait_s = waited_s - std::exchange(row_waited_s_, waited_s);
      if (writes_) append_metrics(run_.paths, row);
    }
    last_was_high_ = is_high(watched(), state_.loss_watch);
    watch_loss(watched(), &state_.loss_watch);
    state_.window = {};
  }

  void print_schedule() const {
    std::printf("%llu training pixels, %lld steps an epoch, %lld steps at most",
                static_cast<unsigned long long>(sampler_.pixels()),
                static_cast<long long>(steps_per_epoch_), static_cast<long long>(steps_));
    if (options_.max_seconds > 0) std::printf(" in %g s", options_.max_seconds);
    std::printf("; %s", state_.model->describe_schedule(steps_).c_str());
    if (state_.rate_factor != 1)
      std::printf("; all of it times %g since it diverged", state_.rate_factor);
    std::printf("\n");
    if (state_.step > 0)
      std::printf("going on from step %lld\n", static_cast<long long>(state_.step));
    std::fflush(stdout);
  }

  double rays_per_second() const {
    return state_.window.seconds > 0 ? state_.window.rays / state_.window.seconds : 0;
  }

  void show_progress() {
    const LossWindow& window = state_.window;
    double left = static_cast<double>(steps_ - state_.step) * window.seconds / window.steps;
    const double time_left = options_.max_seconds - state_.seconds;
    const bool time_ends_it = options_.max_seconds > 0 && time_left < left;
    if (time_ends_it) left = time_left;
    progress_->show(
        progress_line({state_.step, time_ends_it ? 0 : steps_, window.loss / window.steps,
                       decibels(window.mse / window.steps), rays_per_second(), left}));
  }

  TrainEnd end(TrainEnd how) {
    if (state_.window.steps > 0) show_progress();
    if (writes_) progress_->print();
    const ImageCache::Statistics images = data_.images.statistics();
    if (images.reads > 0)
      std::printf("steps waited %.1f s for images; %lld decoded, at most %.1f MB in memory\n",
                  images.waited_s - waited_s_, static_cast<long long>(images.decoded),
                  static_cast<double>(images.most_bytes) / 1e6);
    if (loss_rose()) {
      std::fprintf(stderr, "redrive: step %lld: %s; the checkpoint before that stands\n",
                   static_cast<long long>(state_.step), high_loss().c_str());
      state_ = last_saved();
    } else {
      save();
    }
    return how;
  }

  Run& run_;
  kernels::Backend& backend_;
  ProcessGroup* processes_;  // processes that compute steps together; may be null
  const bool writes_;
  StepObserver* observer_;
  TrainState& state_;
  const TrainOptions& options_;
  PixelSampler sampler_;
  LidarSampler lidar_sampler_;
  TrainingSet data_;
  PoseRefinement refinement_;
  StepBuffers buffers_;
  double saved_seconds_;        // state_.seconds at the last checkpoint
  double progress_before_ = 0;  // progress() before the current step
  bool save_due_ = false;       // since then
  bool last_was_high_ = false;  // the last whole window; false at every checkpoint
  // ViewImages::statistics before the first step and at the last row of metrics.
  double waited_s_ = 0, row_waited_s_ = 0;
  std::int64_t steps_ = 0, steps_per_epoch_ = 0;
  Progress* progress_ = nullptr;  // set by run()
};

}  // namespace

double run_progress(const TrainOptions& options, const TrainState& state) {
  double progress = static_cast<double>(state.pixels_drawn) /
                    (static_cast<double>(options.epochs) * static_cast<double>(state.pixels));
  if (options.max_steps > 0)
    progress = std::max(progress,
                        static_cast<double>(state.step) / static_cast<double>(options.max_steps));
  if (options.max_seconds > 0) progress = std::max(progress, state.seconds / options.max_seconds);
  return progress;
}

TrainEnd train(Run* run, const TrainingData& data, kernels::Backend& backend,
               const std::atomic<bool>& stop, StepObserver* observer, ProcessGroup* processes) {
  return Trainer(run, data, backend, observer, processes).run(stop);
}

TrainEnd train(Run* run, kernels::Backend& backend, const std::atomic<bool>& stop,
               StepObserver* observer) {
  const TrainingData data = load_training_data(*run, backend.pool());
  return train(run, data, backend, stop, observer);
}

}  // namespace redrive
