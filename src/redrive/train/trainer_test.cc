// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/trainer.h"

#include <fstream>
#include <functional>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/train/files/run_lock.h"
#include "redrive/train/train_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

/// Sets every density far below the ReLU's kink, so that all gradients are 0.
void kill_density(Run* run) {
  run->state.model->parameters[nerf_layer(nerf(run->state).config, kNerfDensity).bias] = -1e3f;
}

class TrainerTest : public TrainingTest {
 protected:
  using RunNamed = std::function<redrive::Run(const char* name)>;

  /// Expects that the run `trained`, with checkpoints every 30 of 130 steps, ends the same on one
  /// thread, and when killed and interrupted.
  void expect_same_end(const redrive::Run& trained, const RunNamed& run_named) {
    redrive::Run single = run_named("single"), parts = run_named("parts");
    const auto expect_same = [&](const redrive::Run& other) {
      EXPECT_EQ(curve(other), curve(trained));
      EXPECT_TRUE(same_weights(other.state, trained.state));
      EXPECT_EQ(other.state.poses.corrections.values, trained.state.poses.corrections.values);
    };
    train(&single, *processor_backend(1), never_);
    expect_same(single);
    for (const std::int64_t at : {37, 20}) {
      train_until_killed(&parts, at);
      parts = reopened(parts);
    }
    Interference interference{.stop_after = 12};  // between checkpoints
    InterferingBackend backend(*backend_, &interference);
    EXPECT_EQ(train(&parts, backend, interference.stop), TrainEnd::kInterrupted);
    parts = reopened(parts);
    EXPECT_EQ(parts.state.step, 43);
    train(&parts, *backend_, never_);
    expect_same(parts);
  }

  static bool moved_any(const PoseCorrections& corrections) {
    return std::ranges::any_of(corrections.values,
                               [](float value) { return std::abs(value) > 1e-4f; });
  }
};

TEST_F(TrainerTest, LossFallsAndTheRunFolderIsComplete) {
  redrive::Run run = run_named("run", tiny_options(600));
  EXPECT_EQ(train(&run, *backend_, never_), TrainEnd::kFinished);
  const std::vector<MetricsRow> rows = read_metrics(run.paths);
  ASSERT_EQ(rows.size(), 24u);
  EXPECT_EQ(rows.back().step, 600);
  EXPECT_LT(rows.back().loss, rows.front().loss / 10);
  EXPECT_NEAR(rows.back().psnr_db, -10 * std::log10(rows.back().loss), 1e-9);
  EXPECT_EQ(rows.front().learning_rate, 2e-3);
  EXPECT_EQ(rows.back().learning_rate, 2e-3 / 8);  // after the milestones 300, 450 and 525
  EXPECT_TRUE(same_weights(load_checkpoint(run.paths.checkpoint()), run.state));
  EXPECT_EQ(run.state.restarts, 0);
}

TEST_F(TrainerTest, SameSeedGivesTheSameCurveAndWeightsBitForBit) {
  redrive::Run a = run_named("a", tiny_options(120)), b = run_named("b", tiny_options(120));
  train(&a, *backend_, never_);
  const auto another = processor_backend(2);
  train(&b, *another, never_);
  EXPECT_EQ(curve(a), curve(b));
  EXPECT_TRUE(same_weights(a.state, b.state));

  TrainOptions other_seed = tiny_options(120);
  other_seed.seed = 2;
  redrive::Run c = run_named("c", other_seed);
  train(&c, *backend_, never_);
  EXPECT_FALSE(same_weights(a.state, c.state));
}

TEST_F(TrainerTest, InterruptedAndResumedEndsAsUninterrupted) {
  for (const int fine_samples : {0, 6}) {
    TrainOptions options = tiny_options(130);
    options.set("fine_samples", fine_samples);
    const std::string suffix = std::to_string(fine_samples);
    redrive::Run whole = run_named("whole" + suffix, options),
                 parts = run_named("parts" + suffix, options);
    train(&whole, *backend_, never_);

    for (const std::int64_t steps :
         {0, 12, 50}) {  // stops after 1, 14 and 65 steps: between rows and checkpoints
      Interference interference{.stop_after = steps};
      InterferingBackend backend(*backend_, &interference);
      EXPECT_EQ(train(&parts, backend, interference.stop), TrainEnd::kInterrupted);
      parts = reopened(parts);
    }
    EXPECT_EQ(parts.state.step, 65);
    EXPECT_EQ(train(&parts, *backend_, never_), TrainEnd::kFinished);
    EXPECT_EQ(curve(parts), curve(whole));
    EXPECT_TRUE(same_weights(parts.state, whole.state));
  }
}

TEST_F(TrainerTest, KilledAndResumedEndsAsUninterrupted) {
  const TrainOptions options = tiny_options(130);
  redrive::Run whole = run_named("whole", options), parts = run_named("parts", options);
  train(&whole, *backend_, never_);
  for (const std::int64_t at :
       {30, 77, 20}) {  // the last checkpoints are at 0, 40 (77 + 0 -> 40) and 40
    train_until_killed(&parts, at);
    std::ofstream(parts.paths.metrics(), std::ios::app)
        << "{\"step\": 9";  // a line truncated by the kill
    parts = reopened(parts);
  }
  EXPECT_EQ(parts.state.step, 40);
  train(&parts, *backend_, never_);
  EXPECT_EQ(curve(parts), curve(whole));
  EXPECT_TRUE(same_weights(parts.state, whole.state));
}

// The error map and refined poses depend on earlier steps: neither the number of threads nor
// interruptions may change them.
TEST_F(TrainerTest, AGridWithErrorMapAndPosesEndsTheSameOnAnyThreadsAndWhenKilled) {
  TrainOptions options = tiny_options(130);
  options.checkpoint_every = 30;
  const RunNamed grid_run = [&](const char* name) {
    return tiny_grid_run(folder_.path / name, folder_.path, options);
  };
  redrive::Run whole = grid_run("whole");
  train(&whole, *backend_, never_);
  EXPECT_EQ(whole.state.pixels_drawn, 130u * 32);
  const auto best = std::ranges::min_element(whole.state.cell_errors.span());
  EXPECT_LT(*best, 0.1f * kInitialError);
  EXPECT_GE(*best, 0);
  EXPECT_TRUE(moved_any(whole.state.poses.corrections));
  expect_same_end(whole, grid_run);
}

TEST_F(TrainerTest, ANerfWithPosesEndsTheSameOnAnyThreadsAndWhenKilled) {
  TrainOptions options = tiny_options(130);
  options.checkpoint_every = 30;
  options.set("fine_samples", 6);
  EXPECT_FALSE(run_named("not asked to", options).state.poses.refines());
  options.refine_poses = "on";
  const RunNamed nerf_run = [&](const char* name) { return run_named(name, options); };
  redrive::Run whole = nerf_run("whole");
  train(&whole, *backend_, never_);
  EXPECT_TRUE(moved_any(whole.state.poses.corrections));
  expect_same_end(whole, nerf_run);
}

TEST_F(TrainerTest, ARestartResetsTheErrorMap) {
  const TrainOptions options = tiny_options(40);
  redrive::Run restarted = tiny_grid_run(folder_.path / "restarted", folder_.path, options);
  Interference interference{.nan_from = 20, .nan_to = 21};
  InterferingBackend backend(*backend_, &interference);
  train(&restarted, backend, never_);
  EXPECT_EQ(restarted.state.restarts, 1);
  EXPECT_EQ(restarted.state.step, 40);
  redrive::Run fresh = tiny_grid_run(folder_.path / "fresh", folder_.path, options);
  fresh.state = initial_state(std::move(fresh.state.model), restarted.state.seed);
  fresh.state.poses = PoseState(fresh.scene);
  train(&fresh, *backend_, never_);
  EXPECT_TRUE(same_weights(restarted.state, fresh.state));
  EXPECT_EQ(restarted.state.pixels_drawn, fresh.state.pixels_drawn);
  EXPECT_EQ(restarted.state.poses.corrections.values, fresh.state.poses.corrections.values);
}

TEST_F(TrainerTest, AnEpochDrawsEveryPixelOnce) {
  TrainOptions options = tiny_options(0);  // two images of 24 x 16
  options.epochs = 3;
  redrive::Run nerf = run_named("nerf", options);
  train(&nerf, *backend_, never_);
  EXPECT_EQ(nerf.state.pixels_drawn, 3u * 768);
  EXPECT_EQ(nerf.state.step, 3 * 12);
  options.set("batch_rays", 100);  // 50 and 50, 18 at the end of an epoch
  redrive::Run grid = tiny_grid_run(folder_.path / "grid", folder_.path, options);
  train(&grid, *backend_, never_);
  EXPECT_EQ(grid.state.pixels_drawn, 3u * 768);
  EXPECT_EQ(grid.state.step, 3 * 16);
}

TEST_F(TrainerTest, DeadStartIsRestartedFromAnotherSeed) {
  redrive::Run run = run_named("run", tiny_options(60));
  kill_density(&run);
  EXPECT_EQ(train(&run, *backend_, never_), TrainEnd::kFinished);
  EXPECT_EQ(run.state.restarts, 1);
  EXPECT_NE(run.state.seed, run.options.seed);
  EXPECT_EQ(run.state.step, 60);
  const std::string metrics = read_file(run.paths.metrics());
  EXPECT_THAT(metrics, HasSubstr("\"event\":\"restart\""));
  EXPECT_THAT(metrics, HasSubstr("dead"));
  ASSERT_EQ(read_metrics(run.paths).size(), 3u);  // steps 25, 50 and 60 of the second start only
  EXPECT_EQ(read_metrics(run.paths).front().step, 25);
}

TEST_F(TrainerTest, KilledAroundARestartEndsAsUninterrupted) {
  const TrainOptions options = tiny_options(60);
  redrive::Run whole = run_named("whole", options), parts = run_named("parts", options);
  kill_density(&whole);
  kill_density(&parts);
  train(&whole, *backend_, never_);
  for (const std::int64_t at : {10, 30}) {  // before and after the restart at step 20
    train_until_killed(&parts, at);
    parts = reopened(parts);
  }
  EXPECT_EQ(parts.state.restarts, 1);
  train(&parts, *backend_, never_);
  EXPECT_EQ(curve(parts), curve(whole));
  EXPECT_TRUE(same_weights(parts.state, whole.state));
}

TEST_F(TrainerTest, StartThatIsNeverFiniteGivesUpAfterFiveRestarts) {
  redrive::Run run = run_named("run", tiny_options(60));
  Interference interference{.nan_from = 0, .nan_to = 1000};
  InterferingBackend backend(*backend_, &interference);
  try {
    train(&run, backend, never_);
    ADD_FAILURE() << "no UsageError";
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), HasSubstr("no start out of 6 converged"));
  }
  EXPECT_EQ(run.state.restarts, 5);
}

TEST_F(TrainerTest, LaterStepsThatAreNotFiniteAreSkippedAndCounted) {
  TrainOptions options = tiny_options(1100);
  options.set("batch_rays", 16);
  redrive::Run run = run_named("run", options);
  Interference interference{.nan_from = 1050, .nan_to = 1057};
  InterferingBackend backend(*backend_, &interference);
  EXPECT_EQ(train(&run, backend, never_), TrainEnd::kFinished);
  EXPECT_EQ(run.state.skipped_steps, 7);
  EXPECT_EQ(run.state.bad_steps, 0);
  EXPECT_EQ(run.state.step, 1100);
  EXPECT_EQ(run.state.restarts, 0);
}

TEST_F(TrainerTest, MaxSecondsIncludesTheTimeBeforeResuming) {
  TrainOptions options = tiny_options(0);
  options.max_seconds = 0.05;
  redrive::Run run = run_named("run", options);
  EXPECT_EQ(train(&run, *backend_, never_), TrainEnd::kFinished);
  EXPECT_GE(run.state.seconds, 0.05);
  EXPECT_GT(run.state.step, 0);
  redrive::Run again = reopened(run);
  train(&again, *backend_, never_);
  EXPECT_EQ(again.state.step, run.state.step) << "its time was used up";
}

// Preparation does not use up the time of training, however long it takes: without a step a run
// would look trained.
TEST_F(TrainerTest, ATimeLimitTrainsAStepAtLeast) {
  TrainOptions options = tiny_options(0);
  options.max_seconds = 1e-9;
  redrive::Run run = run_named("run", options);
  EXPECT_EQ(train(&run, *backend_, never_), TrainEnd::kFinished);
  EXPECT_EQ(run.state.step, 1);
}

TEST_F(TrainerTest, ProgressIsThatOfTheLimitThatEndsTheRun) {
  TrainOptions options;
  options.epochs = 2;
  options.max_steps = 10;
  options.max_seconds = 8;
  TrainState state;
  state.step = 1;
  state.seconds = 2;
  state.pixels_drawn = 100;
  state.pixels = 1000;
  EXPECT_DOUBLE_EQ(run_progress(options, state), 0.25);
  options.max_seconds = 0;
  EXPECT_DOUBLE_EQ(run_progress(options, state), 0.1);
  state.pixels = 50;
  EXPECT_DOUBLE_EQ(run_progress(options, state), 1);
}

TEST(Metrics, RejectsAMalformedLineByNumber) {
  TemporaryFolder folder;
  const RunPaths paths{folder.path};
  append_metrics(paths, {25, 1, 0.5, 3, 5e-4, 100, 0});
  std::ofstream(paths.metrics(), std::ios::app) << "{\"step\": 50}\n";
  try {
    read_metrics(paths);
    ADD_FAILURE() << "no InputError";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("metrics.jsonl:2"));
  }
}

TEST(Metrics, RowsThatARollBackUndidAreNeitherReadNorKept) {
  TemporaryFolder folder;
  const RunPaths paths{folder.path};
  const auto row = [&](std::int64_t step) {
    append_metrics(paths, {step, 1, 0.5, 3, 5e-4, 100, 0});
  };
  const auto steps = [&] {
    std::vector<std::int64_t> steps;
    for (const MetricsRow& read : read_metrics(paths)) steps.push_back(read.step);
    return steps;
  };
  for (const int step : {25, 50, 75}) row(step);
  append_rollback(paths, 80, 40, 1, 0.5, "why");
  EXPECT_EQ(steps(), (std::vector<std::int64_t>{25}));
  for (const int step : {50, 75, 100}) row(step);
  EXPECT_EQ(steps(), (std::vector<std::int64_t>{25, 50, 75, 100}));
  truncate_metrics(paths, {0, 1, 60});
  EXPECT_EQ(steps(), (std::vector<std::int64_t>{25, 50}));
  EXPECT_THAT(read_file(paths.metrics()), HasSubstr("why"));
  truncate_metrics(paths, {0, 0, 60});  // the checkpoint from before the roll-back
  EXPECT_EQ(steps(), (std::vector<std::int64_t>{25, 50}));
  EXPECT_THAT(read_file(paths.metrics()), Not(HasSubstr("why")));
  append_restart(paths, 60, 1, 9, "another");
  EXPECT_TRUE(steps().empty());
}

TEST(Metrics, TruncatesAtTheFirstUnreadableLine) {
  TemporaryFolder folder;
  const RunPaths paths{folder.path};
  for (const int step : {25, 50, 75}) append_metrics(paths, {step, 1, 0.5, 3, 5e-4, 100, 0});
  const std::string whole = read_file(paths.metrics()), zeros(100, '\0');
  const std::size_t line = whole.find('\n') + 1;
  for (const std::string& tail :
       {zeros, zeros + "\n", std::string("{\"step\": 1"), "{\"step\": 1\n" + whole}) {
    write_file(paths.metrics(), whole + tail);
    truncate_metrics(paths, {0, 0, 100});
    EXPECT_EQ(read_file(paths.metrics()), whole);
    write_file(paths.metrics(), whole.substr(0, line) + tail);
    truncate_metrics(paths, {0, 0, 100});
    EXPECT_EQ(read_file(paths.metrics()), whole.substr(0, line));
  }
}

TEST(Run, IsLockedByOneProcess) {
  TemporaryFolder folder;
  {
    const RunLock lock(folder.path);
    try {
      const RunLock second(folder.path);
      ADD_FAILURE() << "no UsageError";
    } catch (const UsageError& error) {
      EXPECT_THAT(error.what(), HasSubstr("is being trained by another process"));
    }
  }
  const RunLock again(folder.path);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path));
  EXPECT_THROW(RunLock(folder.path / "none"), InputError);
}

TEST(Run, IsCreatedAtomicallyWithoutATrailingSlash) {
  TemporaryFolder folder;
  const RunPaths paths = create_run(folder.path / "below" / "run" / "", tiny_options(1));
  EXPECT_EQ(paths.root, folder.path / "below" / "run");
  EXPECT_TRUE(std::filesystem::exists(paths.config()));
  const std::filesystem::directory_iterator entries(folder.path / "below");
  EXPECT_EQ(std::distance(begin(entries), end(entries)), 1) << "no temporary folder is left";
}

TEST(Run, RejectsAnExistingFolderUnchanged) {
  TemporaryFolder folder;
  TrainOptions options = tiny_options(1);
  EXPECT_THROW(create_run(folder.path, options), UsageError);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path));
  std::ofstream(folder.path / "file") << "mine";
  EXPECT_THROW(create_run(folder.path / "file", options), UsageError);
  EXPECT_EQ(read_file(folder.path / "file"), "mine");
  EXPECT_THROW(create_run(folder.path / "file" / "below", options), IoError);
}

}  // namespace
}  // namespace redrive
