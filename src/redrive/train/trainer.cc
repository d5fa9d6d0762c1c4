// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/trainer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"
#include "redrive/rays/lidar_sampler.h"
#include "redrive/train/data_parallel_group.h"
#include "redrive/train/loss_watch.h"
#include "redrive/train/pose_refiner.h"
#include "redrive/train/progress.h"
#include "redrive/train/start_watch.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

constexpr int kStepsPerRow =
    25;  // a row of metrics.jsonl: 1024 rays x 25 average the noise of a batch away
constexpr int kMaxBadSteps = 50;  // non-finite ones on end: it will not heal
constexpr double kSecondsPerCheckpoint =
    60;  // of training: what a kill costs at most, however slow the machine

// Poses are refined on one step in four, which costs it a third more, once there is something to
// see. Rates of an update, and of that at the end.
constexpr std::int64_t kStepsPerRefinement = 4;
constexpr double kFirstRefinement = 0.02, kFirstPoseRate_m = 1e-3, kLastPoseRate = 0.01;

double decibels(double mse) { return -10 * std::log10(std::max(mse, 1e-10)); }

/// One call of train(): the run, what is constant in it, and what the loop's parts share.
class Trainer {
 public:
  Trainer(Run* run, const TrainingData& data, const std::vector<kernels::Backend*>& backends,
          kernels::AllReduce* reduction)
      : run_(*run),
        state_(run->state),
        options_(run->options),
        scene_(run->scene),
        sampler_(scene_, data.images, run->options.seed),
        lidar_sampler_(data.lidar, run->options.seed),
        use_lidar_(options_.lidar_rays > 0 && data.lidar.n > 0),
        team_(backends, reduction, &run->state),
        saved_seconds_(run->state.seconds) {
    const std::int64_t per_epoch =
        sampler_.steps_per_epoch(team_.size() * (rays() - n_error_map_rays()));
    steps_ = total_steps(options_, per_epoch);
    milestones_ = milestones(options_, per_epoch);
    steps_per_epoch_ = per_epoch;
    adapt_state();
  }

  TrainEnd run(const std::atomic<bool>& stop) {
    truncate_metrics(run_.paths, {state_.restarts, state_.rollbacks, state_.step});
    print_schedule();
    if (state_.step == 0) save();
    while (true) {
      while (progress() < 1) {
        if (stop) return end(TrainEnd::kInterrupted);
        step();
      }
      if (state_.window.steps > 0) close_window();
      if (!loss_rose()) return end(TrainEnd::kFinished);
      roll_back(high_loss());
    }
  }

 private:
  double learning_rate(std::int64_t step) const {
    const double rate = state_.rate_factor * options_.learning_rate;
    if (options_.method == "nerf")
      return multi_step_learning_rate(rate, options_.lr_gamma, milestones_, step);
    return exponential_decay_rate(rate, options_.lr_gamma, std::min(progress(), 1.0), step);
  }

  double pose_rate() const { return kFirstPoseRate_m * std::pow(kLastPoseRate, progress()); }
  // Of each member of the team:
  int rays() const { return rays_per_step(options_.batch_rays, state_.active_fraction); }
  int n_error_map_rays() const { return static_cast<int>(options_.error_rays * rays()); }

  /// Of the run, by the limit that is nearest: 1 is its end.
  double progress() const {
    const auto pixels =
        static_cast<double>(options_.epochs) * static_cast<double>(sampler_.pixels());
    double progress = static_cast<double>(state_.rays_drawn) / pixels;
    if (options_.max_steps > 0)
      progress = std::max(
          progress, static_cast<double>(state_.step) / static_cast<double>(options_.max_steps));
    if (options_.max_seconds > 0)
      progress = std::max(progress, state_.seconds / options_.max_seconds);
    return progress;
  }

  /// What the state knows of the pixels, where they are others than before, as after masks were
  /// edited, or it is fresh.
  void adapt_state() {
    if (state_.loss_watch.pixels != sampler_.pixels()) state_.loss_watch = {sampler_.pixels()};
    const std::size_t cells = n_error_map_rays() > 0 ? sampler_.cells().size() : 0;
    if (state_.cell_errors.size() != cells) {
      state_.cell_errors = Buffer<float>(cells);
      std::ranges::fill(state_.cell_errors.span(), kInitialError);
    }
    team_.begin();
    place();
  }

  /// Everything where the corrections put it.
  void place() {
    if (!state_.poses.refines()) return;
    const std::vector<FramePose>& recorded = run_.recording.frames;
    const std::vector<FramePose> trajectory =
        apply_corrections(run_.scene, recorded, state_.poses.corrections, &scene_);
    sampler_.update_poses();
    lidar_sampler_.update_poses(scene_.global_from_world, recorded, trajectory);
  }

  bool refines() const {
    return state_.poses.refines() && state_.step % kStepsPerRefinement == 0 &&
           progress() > kFirstRefinement;
  }

  void gather(Rank* member) const {
    const auto [rank, of] = member->share;
    gather_batch(member->backend, sampler_, rays() - n_error_map_rays(), n_error_map_rays(),
                 member->state, &member->batch, &member->buffers, member->share);
    member->batch.refines = refines();
    if (!use_lidar_) return;
    gather_lidar(member->backend, lidar_sampler_, of * state_.step + rank, options_.lidar_rays,
                 &member->lidar, &member->buffers);
    member->lidar.first_ray = static_cast<std::uint64_t>(rank) * options_.lidar_rays;
  }

  void step() {
    const auto begin = std::chrono::steady_clock::now();
    const std::int64_t number = state_.step;
    const StepResult result =
        team_.step([this](Rank& member) { gather(&member); }, learning_rate(number));
    const Rank& first = team_.first();
    if (first.batch.refines && result.finite) {
      refine_poses(scene_, team_.view_gradients(scene_), pose_rates(pose_rate()), &state_.poses);
      place();
    }
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    state_.seconds += seconds;

    if (watches_colours(number)) kernels::download(first.backend, first.batch.target);
    if (const auto reason = watch_start(result, first.batch, number, &state_.watch))
      return restart(*reason);
    if (!result.finite) return skip();
    state_.bad_steps = 0;
    LossWindow& window = state_.window;
    ++window.steps;
    window.rays += result.rays;
    window.loss += result.loss;
    window.mse += result.rgb_mse;
    window.seconds += seconds;
    if (progress_.due()) show_progress();
    if (state_.step % kStepsPerRow == 0) close_window();
    if (has_diverged(state_.loss_watch)) return roll_back(high_loss());
    save_due_ |= state_.step % options_.checkpoint_every == 0 ||
                 state_.seconds - saved_seconds_ >= kSecondsPerCheckpoint;
    if (save_due_ && !loss_rose()) save();  // the checkpoint has to stay one to go back to
  }

  void save() {
    sync_metrics(run_.paths);
    for (const Buffer<float>* numbers : {&state_.model->parameters, &state_.first_moment,
                                         &state_.second_moment, &state_.cell_errors})
      team_.first().backend.download(*numbers);
    save_checkpoint(run_.paths.checkpoint(), state_);
    saved_seconds_ = state_.seconds;
    save_due_ = false;
  }

  bool loss_rose() const { return last_was_high_ || is_high(state_.window, state_.loss_watch); }

  /// A start that failed: the same run once more from another seed.
  void restart(const std::string& reason) {
    progress_.finish();
    if (state_.restarts == kMaxRestarts)
      throw UsageError("--learning-rate", std::to_string(options_.learning_rate),
                       "no start out of " + std::to_string(kMaxRestarts + 1) + " converged (" +
                           reason + "); try a lower rate");
    const int restarts = state_.restarts + 1;
    TrainState fresh = initial_state(std::move(state_.model),
                                     mix64(options_.seed + static_cast<std::uint64_t>(restarts)));
    if (state_.poses.refines()) fresh.poses = PoseState(run_.scene);
    fresh.restarts = restarts;
    fresh.seconds = state_.seconds;
    std::fprintf(stderr,
                 "redrive: step %lld: %s; restarting from another seed (%d of at most %d)\n",
                 static_cast<long long>(state_.step), reason.c_str(), restarts, kMaxRestarts);
    append_restart(run_.paths, state_.step, restarts, fresh.seed, reason);
    state_ = std::move(fresh);
    adapt_state();
    last_was_high_ = false;
    save();
  }

  /// A later step that was not finite: the parameters stayed as they were.
  void skip() {
    ++state_.skipped_steps;
    ++state_.bad_steps;
    progress_.finish();
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

  /// Back to the last checkpoint, at a lower rate.
  void roll_back(const std::string& reason) {
    progress_.finish();
    if (state_.rollbacks == kMaxRollbacks)
      throw UsageError("--learning-rate", std::to_string(options_.learning_rate),
                       reason + ", as " + std::to_string(kMaxRollbacks) +
                           " times before at higher rates than " +
                           std::to_string(state_.rate_factor) + " of it; the last good state is " +
                           run_.paths.checkpoint().string() + "; try a lower rate");
    state_.model->parameters = {};  // room for the other
    state_.first_moment = {};
    state_.second_moment = {};
    TrainState good = load_checkpoint(run_.paths.checkpoint());
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
    append_rollback(run_.paths, state_.step, good.step, good.rollbacks, good.rate_factor, reason);
    state_ = std::move(good);
    adapt_state();
    last_was_high_ = false;
    save();
  }

  void close_window() {
    const LossWindow& window = state_.window;
    if (window.steps > 0)
      append_metrics(run_.paths, {state_.step, state_.seconds, window.loss / window.steps,
                                  decibels(window.mse / window.steps),
                                  learning_rate(state_.step - 1), rays_per_second(),
                                  static_cast<int>((state_.rays_drawn - 1) / sampler_.pixels())});
    last_was_high_ = is_high(window, state_.loss_watch);
    watch_loss(window, &state_.loss_watch);
    state_.window = {};
  }

  void print_schedule() const {
    std::printf("%llu training pixels, %lld steps an epoch, %lld steps at most",
                static_cast<unsigned long long>(sampler_.pixels()),
                static_cast<long long>(steps_per_epoch_), static_cast<long long>(steps_));
    if (options_.max_seconds > 0) std::printf(" in %g s", options_.max_seconds);
    std::printf("; learning rate %g", options_.learning_rate);
    if (options_.method != "nerf") {
      std::printf(", in the end times %g", options_.lr_gamma);
    } else if (!milestones_.empty()) {
      std::printf(", times %g at", options_.lr_gamma);
      for (const std::int64_t milestone : milestones_)
        std::printf(" %lld", static_cast<long long>(milestone));
    }
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
    progress_.show({state_.step, time_ends_it ? 0 : steps_, window.loss / window.steps,
                    decibels(window.mse / window.steps), rays_per_second(), left});
  }

  TrainEnd end(TrainEnd how) {
    if (state_.window.steps > 0) show_progress();
    progress_.finish();
    if (loss_rose()) {
      std::fprintf(stderr, "redrive: step %lld: %s; the checkpoint before that stands\n",
                   static_cast<long long>(state_.step), high_loss().c_str());
      state_ = load_checkpoint(run_.paths.checkpoint());
    } else {
      save();
    }
    return how;
  }

  Run& run_;
  TrainState& state_;
  const TrainOptions& options_;
  Scene scene_;  // the run's with the views where corrections have put them
  PixelSampler sampler_;
  LidarSampler lidar_sampler_;
  bool use_lidar_;
  DataParallelGroup team_;
  double saved_seconds_;        // state_.seconds at the last checkpoint
  bool save_due_ = false;       // since then
  bool last_was_high_ = false;  // the last whole window; false at every checkpoint
  std::vector<std::int64_t> milestones_;
  std::int64_t steps_ = 0, steps_per_epoch_ = 0;
  Progress progress_;
};

}  // namespace

TrainEnd train(Run* run, const TrainingData& data, const std::vector<kernels::Backend*>& backends,
               kernels::AllReduce* reduction, const std::atomic<bool>& stop) {
  const auto how_to_go_on = [&](const std::exception& error) {
    return "step " + std::to_string(run->state.step) + ": " + error.what() +
           "; the last checkpoint stands, go on from it with: redrive resume " +
           run->paths.root.string();
  };
  try {
    return Trainer(run, data, backends, reduction).run(stop);
  } catch (const DeviceError& error) {  // a checkpoint is fetched whole before any of it is written
    throw DeviceError(how_to_go_on(error));
  } catch (const DeviceMemoryError& error) {
    throw DeviceMemoryError(how_to_go_on(error));
  }
}

TrainEnd train(Run* run, kernels::Backend& backend, const std::atomic<bool>& stop) {
  const TrainingData data = [&] {
    ThreadPool pool(backend.threads());
    return load_training_data(*run, pool);
  }();
  return train(run, data, {&backend}, nullptr, stop);
}

}  // namespace redrive
